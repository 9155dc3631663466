"""Weather files, their noise and their design days."""
