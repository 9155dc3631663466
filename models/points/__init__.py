"""Points of a model: which it offers, and which are selected."""
