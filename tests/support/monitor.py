"""A two-storey office for the monitor's tests: its manifest, geometry, samples, and a reader of recordings."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rerun.chunk import RrdReader

from support import builders
from zenostat.topics import codec
from zenostat.topics.messages import Geometry, Manifest, Sample, SurfaceKind, ZoneGeometry

ZONES = ("Core_ZN", "Perimeter_ZN_1")
BEGIN = np.datetime64("2017-07-01T00:00", "ns")
STEP = np.timedelta64(900, "s").astype("m8[ns]")


def office(**changes: Any) -> Manifest:
    """Two zones with temperatures and occupants, outdoor temperature, two meters, two setpoints of one zone."""
    names = ("core", "perimeter")
    people = "Zone People Occupant Count"
    manifest = builders.manifest(
        sensors=[
            builders.sensor("outdoor_temperature", "Site Outdoor Air Drybulb Temperature", "Environment"),
            *(builders.sensor(f"{name}_air_temperature", key=zone) for name, zone in zip(names, ZONES, strict=True)),
            *(builders.sensor(f"{n}_occupants", people, zone, "1") for n, zone in zip(names, ZONES, strict=True)),
        ],
        meters=[builders.meter("electricity"), builders.meter("cooling", "Cooling:Electricity")],
        actuators=[builders.actuator("heating_setpoint"), builders.actuator("cooling_setpoint")],
    )
    return manifest.model_copy(update=changes)


def samples(
    manifest: Manifest,
    values: ArrayLike,
    *,
    episode: int = 0,
    first: int = 0,
    effective: Sequence[float] = (20.0, 25.0),
    commanded: Sequence[float] | None = None,
    sources: Sequence[Sequence[str]] | None = None,
    fault_free: ArrayLike | None = None,
) -> list[Sample]:
    """Consecutive samples with these values, shape (n, points); `sources` names each sample's value sources."""
    messages = []
    rows = np.asarray(values, float)
    plant = None if fault_free is None else np.asarray(fault_free, float)
    for number, row in enumerate(rows):
        by = list(sources[number]) if sources is not None else [""] * len(manifest.actuators)
        known = ["", *dict.fromkeys(name for name in by if name)]
        messages.append(
            Sample(
                episode=[episode],
                step=[first + number],
                time=[str((BEGIN + (first + number) * STEP).astype("M8[s]"))],
                elapsed_s=[900.0 * (first + number)],
                flags=[0],
                values=row.astype(codec.FLOAT).tobytes(),
                effective=np.array(effective[: len(manifest.actuators)], codec.FLOAT).tobytes(),
                commanded=b"" if commanded is None else np.asarray(commanded, codec.FLOAT).tobytes(),
                source_index=np.array([known.index(name) for name in by], codec.INDEX).tobytes(),
                sources=known,
                fault_free_values=b"" if plant is None else plant[number].astype(codec.FLOAT).tobytes(),
            )
        )
    return messages


def rows(count: int, **columns: ArrayLike) -> np.ndarray:
    """Values of `office`, shape (count, 7): 22 degC in both zones, nobody there, no energy, unless given."""
    table = np.zeros((count, 7))
    table[:, 1:3] = 22.0
    for name, column in columns.items():
        table[:, list(office().names).index(name)] = column
    return table


def box(low: Sequence[float], high: Sequence[float]) -> list[tuple[SurfaceKind, list[list[float]]]]:
    """The floor, the ceiling and the four walls of a box, counter-clockwise as seen from outside."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    floor = [[x0, y0, z0], [x0, y1, z0], [x1, y1, z0], [x1, y0, z0]]
    roof = [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]]
    walls = [
        [[x0, y0, z1], [x0, y0, z0], [x1, y0, z0], [x1, y0, z1]],
        [[x1, y0, z1], [x1, y0, z0], [x1, y1, z0], [x1, y1, z1]],
        [[x1, y1, z1], [x1, y1, z0], [x0, y1, z0], [x0, y1, z1]],
        [[x0, y1, z1], [x0, y1, z0], [x0, y0, z0], [x0, y0, z1]],
    ]
    return [(SurfaceKind.FLOOR, floor), (SurfaceKind.CEILING, roof), *((SurfaceKind.WALL, wall) for wall in walls)]


def geometry(
    zones: Sequence[tuple[str, int, Sequence[float], Sequence[float], bool]], storeys: Sequence[float]
) -> Geometry:
    """Boxes in Denver: name, storey, low and high corner and whether it is conditioned, of each zone."""
    kinds: list[int] = []
    zone_index: list[int] = []
    corners: list[list[list[float]]] = []
    for index, (_, _, low, high, _) in enumerate(zones):
        for kind, polygon in box(low, high):
            kinds.append(kind)
            zone_index.append(index)
            corners.append(polygon)
    return Geometry(
        zones=tuple(
            ZoneGeometry(name=name, storey=storey, floor_area_m2=1.0, is_conditioned=is_conditioned)
            for name, storey, _, _, is_conditioned in zones
        ),
        storeys=tuple(storeys),
        latitude_deg=39.8,
        longitude_deg=-104.9,
        time_zone_h=-7.0,
        kinds=bytes(kinds),
        zone_index=np.array(zone_index, "<i2").tobytes(),
        exposed=bytes(len(kinds)),
        corner_counts=np.array([len(polygon) for polygon in corners], "<u2").tobytes(),
        corners=np.array([corner for polygon in corners for corner in polygon], "<f4").tobytes(),
    )


def two_storeys() -> Geometry:
    """The zones of `office`, one above the other, and a plenum below the upper one."""
    return geometry(
        [
            (ZONES[0], 0, (0, 0, 0), (20, 10, 3), True),
            ("Plenum", 0, (0, 0, 3), (20, 10, 4), False),
            (ZONES[1].upper(), 1, (0, 0, 4), (20, 10, 7), True),
        ],
        [0.0, 4.0],
    )


def logged(path: Path, component: str) -> dict[str, dict[int, Any]]:
    """Values of a component by entity and step, as a recording has them; without static ones."""
    by_entity: dict[str, dict[int, Any]] = {}
    for entity, columns in _chunks(path, is_static=False):
        if component in columns:
            steps = by_entity.setdefault(entity, {})
            steps.update(zip(columns["step"], columns[component], strict=True))
    return by_entity


def times(path: Path, entity: str) -> dict[int, np.datetime64]:
    """Simulated time of each row of an entity, by step."""
    moments_by_step: dict[int, np.datetime64] = {}
    for name, columns in _chunks(path, is_static=False):
        if name == entity and "simulated" in columns:
            moments = [np.datetime64(moment, "ns") for moment in columns["simulated"]]
            moments_by_step.update(zip(columns["step"], moments, strict=True))
    return moments_by_step


def static(path: Path, component: str) -> dict[str, Any]:
    """Latest static value of a component by entity."""
    return {entity: columns[component][-1] for entity, columns in _chunks(path, is_static=True) if component in columns}


def _chunks(path: Path, *, is_static: bool) -> Iterator[tuple[str, dict[str, list[Any]]]]:
    for chunk in RrdReader(str(path)).stream():
        if chunk.is_static == is_static:
            yield str(chunk.entity_path), chunk.to_record_batch().to_pydict()
