"""What people look at: the live monitor, reports, rendered frames of environments."""
