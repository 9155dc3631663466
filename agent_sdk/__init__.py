"""A controller's side of Zenostat: `connect`, and the Gymnasium environments under `zenostat/`."""

import gymnasium

from agent_sdk.client import Bus, ControlLink, connect

__all__ = ["Bus", "ControlLink", "connect"]

gymnasium.register("zenostat/Building-v1", entry_point="agent_sdk.environment:BuildingEnv")
