"""What a step costs, as ratios within one run. Never a timed test."""
