"""The `zenostat` command: one module for each subcommand, each a thin layer over the other packages."""
