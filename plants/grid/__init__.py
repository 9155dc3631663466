"""Electric grids as plants, calculated with power-grid-model."""
