"""Building models: reading, editing, preparing and summarizing them."""
