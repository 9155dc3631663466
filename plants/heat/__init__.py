"""District heating networks as plants."""
