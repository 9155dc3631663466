"""Controllers: objects with `act(sample)`, for processes of their own and for environments alike."""

from agent_sdk.controllers.base import BuildingControl, Controller
from agent_sdk.controllers.rule_based import ComfortBandRules

CONTROLLERS: dict[str, type[Controller]] = {"building": BuildingControl, "rbc": ComfortBandRules}
"""Short names, as `zenostat run --controller` takes them."""

__all__ = ["CONTROLLERS", "BuildingControl", "ComfortBandRules", "Controller"]
