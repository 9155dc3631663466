"""The manifest of a node."""

from __future__ import annotations

from typing import Any

from zenostat.bridge.node.history import History
from zenostat.bridge.node.plant import Plant, PlantDescription, RunningPlant, Site
from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.runtime import affinity
from zenostat.topics.messages import Geometry, Manifest


def node_manifest(
    settings: NodeSettings, plant: Plant, history: History | None, *, instance: str, cpu: int | None
) -> Manifest:
    """Describe a node.

    Args:
        settings: of the node.
        plant: at its first sample.
        history: of the present episode; None if it keeps none.
        instance: the id of its Zenoh session.
        cpu: the core on which it runs; None if it is not placed.
    """
    return described_manifest(
        settings,
        plant.description,
        instance=instance,
        history_samples=history.samples if history is not None else 0,
        history_bytes=history.size_bytes if history is not None else 0,
        host=affinity.host(),
        cpu=cpu,
        **site_fields(plant.site(0)),
    )


def described_manifest(
    settings: NodeSettings, description: PlantDescription, *, instance: str = "", **fields: Any
) -> Manifest:
    """Return the manifest of a node as far as its settings and its plant's description determine it.

    Args:
        settings: of the node.
        description: of its plant.
        instance: the id of its Zenoh session.
        fields: further fields of the manifest.
    """
    run_period = description.run_period
    return Manifest(
        node=settings.name,
        instance=instance,
        building=description.name,
        zones=description.zones,
        floor_area_m2=description.floor_area_m2,
        begin=run_period.begin.isoformat(),
        end=run_period.end.isoformat(),
        step_s=run_period.step_s,
        steps=run_period.steps,
        slots=settings.slots,
        baseline=settings.baseline,
        mode=settings.mode,
        speed=settings.speed,
        policy=settings.policy,
        grace_s=settings.grace_s,
        deadline_s=settings.deadline_s,
        sensors=description.sensors,
        meters=description.meters,
        actuators=description.actuators,
        connected=dict(description.connected),
        task=settings.task(description.task),
        warnings=description.warnings,
        versions=description.versions,
        **fields,
    )


def site_fields(site: Site) -> dict[str, Any]:
    """Return the fields of a manifest that describe the weather file and its location."""
    return {
        "weather": site.weather,
        "location": site.location,
        "latitude_deg": site.latitude_deg,
        "longitude_deg": site.longitude_deg,
    }


def located_geometry(plant: RunningPlant) -> Geometry | None:
    """Return the geometry at the place of the present episode of slot 0; None for a plant without. Thread-safe."""
    geometry, site = plant.description.geometry, plant.site(0)
    if geometry is None:
        return None
    place = {name: getattr(site, name) for name in ("latitude_deg", "longitude_deg", "time_zone_h")}
    return geometry.model_copy(update={name: value for name, value in place.items() if value is not None})
