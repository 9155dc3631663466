"""Figures of a report, each defined once for pages and for papers."""
