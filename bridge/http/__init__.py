"""HTTP servers of gateways and views: their sockets, and connections that end without requests."""
