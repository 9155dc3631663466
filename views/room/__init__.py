"""The control room: a web page to watch and operate the nodes of a bus."""
