"""Views for people: the live monitor, reports, rendered frames of environments."""
