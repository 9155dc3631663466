"""A controller's side of Zenostat: `connect`, and the Gymnasium environments under `zenostat/`."""

from agent_sdk.client import Bus, ControlLink, connect

__all__ = ["Bus", "ControlLink", "connect"]
