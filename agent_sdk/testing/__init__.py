"""Test kit: a fake building, and conformance checks for plants, controllers, rewards and environments of your own."""

from zenostat.agent_sdk.testing.check_controller import check_controller
from zenostat.agent_sdk.testing.check_environment import check_environment
from zenostat.agent_sdk.testing.check_plant import check_plant
from zenostat.agent_sdk.testing.check_reward import check_reward
from zenostat.agent_sdk.testing.climate import Climate
from zenostat.agent_sdk.testing.fake_building import FakeBuilding
from zenostat.agent_sdk.testing.fake_env import FakeEnv
from zenostat.agent_sdk.testing.fake_link import FakeLink
from zenostat.agent_sdk.testing.fake_plant import FakePlant
from zenostat.agent_sdk.testing.rc_zones import RCZones, Zone, ZoneStep
from zenostat.agent_sdk.testing.report import ConformanceError, Report, Result

__all__ = [
    "Climate",
    "ConformanceError",
    "FakeBuilding",
    "FakeEnv",
    "FakeLink",
    "FakePlant",
    "RCZones",
    "Report",
    "Result",
    "Zone",
    "ZoneStep",
    "check_controller",
    "check_environment",
    "check_plant",
    "check_reward",
]
