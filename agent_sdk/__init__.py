"""A controller's side of Zenostat: `connect`, and the Gymnasium environments under `zenostat/`."""

import gymnasium

from agent_sdk.client import Bus, connect
from agent_sdk.link import ControlLink

__all__ = ["Bus", "ControlLink", "connect"]

gymnasium.register("zenostat/Building-v1", entry_point="agent_sdk.environment:BuildingEnv")
