"""A controller's side of Zenostat: `connect`, and the Gymnasium environments under `zenostat/`."""

from agent_sdk import registration
from agent_sdk.bus.bus import Bus, connect
from agent_sdk.bus.controller_link import ControllerLink

__all__ = ["Bus", "ControllerLink", "connect"]

registration.register()
