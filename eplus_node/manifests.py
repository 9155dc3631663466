"""The manifest of a node."""

from __future__ import annotations

from typing import Any

from bridge.runtime import affinity
from eplus_node.plan import Plan
from models import energyplus
from models.scenario.episode_weather import WeatherSource
from topics import VERSION
from topics.messages import Manifest, Versions


def node_manifest(plan: Plan, source: WeatherSource, *, instance: str, cpu: int | None) -> Manifest:
    """Describe a node.

    Args:
        plan: what it simulates.
        source: the weather file of slot 0.
        instance: the id of its Zenoh session.
        cpu: the core on which it runs; None if it is not placed.
    """
    config = plan.config
    return Manifest(
        node=config.name,
        instance=instance,
        building=plan.building.name,
        **weather_fields(source),
        begin=plan.period.time(0).isoformat(),
        end=plan.period.time(plan.period.steps).isoformat(),
        steps_per_hour=plan.period.steps_per_hour,
        steps=plan.period.steps,
        slots=config.slots,
        baseline=config.baseline,
        mode=config.mode,
        speed=config.speed,
        policy=config.policy,
        grace_s=config.grace_s,
        deadline_s=config.deadline_s,
        sensors=plan.points.sensors,
        meters=plan.points.meters,
        actuators=plan.points.actuators,
        task=plan.task,
        warnings=plan.warnings,
        versions=Versions(zenostat=VERSION, energyplus=energyplus.version()),
        host=affinity.host(),
        cpu=cpu,
    )


def weather_fields(source: WeatherSource) -> dict[str, Any]:
    """Return the fields of a manifest that describe a weather file."""
    header = source.header
    return {
        "weather": source.name,
        "location": header.place,
        "latitude_deg": header.latitude_deg,
        "longitude_deg": header.longitude_deg,
    }
