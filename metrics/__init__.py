"""Trajectories of episodes, and what is computed from them: metrics, KPIs, comfort, tariffs, roles of points."""
