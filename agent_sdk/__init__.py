"""A controller's side of Zenostat: `connect`, and the Gymnasium environments under `zenostat/`."""

from agent_sdk import registration
from agent_sdk.bus.bus import Bus, connect
from agent_sdk.bus.controller_link import ControlLink

__all__ = ["Bus", "ControlLink", "connect"]

registration.register()
