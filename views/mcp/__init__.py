"""The server of `zenostat mcp`: tools with which a language model reads a bus, asks what-if, and writes if it may."""
