"""The semantic model of a building: its equipment and points in the classes of Brick."""
