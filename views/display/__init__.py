"""Names, colors and roles of a node's points for pictures and reports."""
