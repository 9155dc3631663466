"""Nodes as FMUs: an archive for tools that import FMUs, and the gateway to which its binary connects."""
