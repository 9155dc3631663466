"""Pictures of episodes, drawn with matplotlib (the extra `plots`)."""
