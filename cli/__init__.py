"""The front door: the `zenostat` command, one file a subcommand, nothing but calls into the rooms."""
