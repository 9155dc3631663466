"""The building in 3D: static meshes whose colors follow the zones' deviation from the comfort band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Geometry
from zenostat.views.display.colors import UNKNOWN, comfort_colors
from zenostat.views.display.surfaces import sun_direction
from zenostat.views.live.meshes import BuildingModel, Mesh
from zenostat.views.live.recording import EpisodeLog
from zenostat.views.live.samples import SampleBlock

BUILDING = "building"
QUANTUM_K = 0.25
"""Resolution of the colors."""

PERIOD_S = 900
"""Shortest interval between two colors of a zone, in simulated seconds."""

_SUN_PERIOD_S, _LONG_SUN_PERIOD_S = 1800, 3600
"""Interval between two positions of the sun, in simulated seconds: in episodes of up to 31 days, and in longer ones."""

_MAX_NAMES = 16
"""Largest number of zones whose names are drawn; more would hide the building."""

_WINDOW = (120, 178, 226, 110)
_DOOR = (88, 80, 74, 255)
_SHADING = (150, 154, 158, 120)
_PHOTOVOLTAIC = (28, 42, 92, 230)
_GROUND = (46, 50, 54, 255)
_NORTH = (232, 232, 232)
_SUN = (255, 214, 64)
_OTHERS = {"windows": _WINDOW, "doors": _DOOR, "shading": _SHADING, "photovoltaics": _PHOTOVOLTAIC}


class ColorChanges:
    """Selects the samples at which the color of a zone changes noticeably.

    A color is a multiple of `QUANTUM_K`; there is one at most every `PERIOD_S` of simulated time.
    """

    def __init__(self, zones: int) -> None:
        self._shown: list[float | None] = [None] * zones
        self._period = -1

    def select(self, times: NDArray[np.datetime64], deviations: Floats) -> list[tuple[NDArray[np.intp], Floats]]:
        """Return, for each zone, the rows of its new colors and the deviations that they show in K.

        Args:
            times: datetime64[ns], ascending, shape (n,).
            deviations: in K, NaN if unknown, shape (n, zones).
        """
        periods = times.astype(np.int64) // (PERIOD_S * 10**9)
        rows = np.flatnonzero(periods != np.concatenate([[self._period], periods[:-1]]))
        if len(periods):
            self._period = int(periods[-1])
        quantized = np.rint(deviations[rows] / QUANTUM_K) * QUANTUM_K
        # Slightly outside is not within.
        quantized = np.where(
            (quantized == 0) & (np.abs(deviations[rows]) > 0.05), np.sign(deviations[rows]) * 0.1, quantized
        )
        changes = []
        for zone, column in enumerate(quantized.T):
            kept, shown = [], self._shown[zone]
            for place, value in enumerate(column.tolist()):
                if shown is None or (value != shown and not (value != value and shown != shown)):
                    kept.append(place)
                    shown = value
            self._shown[zone] = shown
            changes.append((rows[kept], column[kept]))
        return changes


class BuildingView:
    """Logs one building's geometry, colors and sun.

    Args:
        log: where to log.
        model: meshes of the building.
        geometry: of the node, for the sun's position.
        zones: names of the zones of a block's deviations, in EnergyPlus, and their labels.
        is_long: whether the episode is longer than 31 days.
    """

    def __init__(
        self,
        log: EpisodeLog,
        model: BuildingModel,
        geometry: Geometry,
        zones: Sequence[tuple[str, str]],
        *,
        is_long: bool = False,
    ) -> None:
        self._log, self._model, self._geometry = log, model, geometry
        labels = {name.casefold(): label for name, label in zones}
        self._paths = {name: f"{BUILDING}/zones/{labels.get(name.casefold(), name)}" for name in model.zones}
        drawn = {name.casefold(): path for name, path in self._paths.items()}
        keys = [name.casefold() for name, _ in zones]
        self._colored = [(column, drawn[key]) for column, key in enumerate(keys) if key in drawn]
        self._changes = ColorChanges(len(zones))
        self._sun_period_s = _LONG_SUN_PERIOD_S if is_long else _SUN_PERIOD_S
        self._sun_period = -1
        self._log_meshes()
        self._log_surroundings()
        self._log_names(labels)

    def _log_meshes(self) -> None:
        colored = {path for _, path in self._colored}
        for name, part in self._model.zones.items():
            path = self._paths[name]
            # A static color would hide the colors over time.
            self._log.static(path, _mesh(part, None if path in colored else (*UNKNOWN, 255)))
        for name, part in self._model.others.items():
            self._log.static(f"{BUILDING}/{name}", _mesh(part, _OTHERS[name]))

    def _log_surroundings(self) -> None:
        """Log the ground, and north."""
        low, high = self._model.low, self._model.high
        margin = 0.12 * float(np.linalg.norm((high - low)[:2]))
        left, front, right, back = low[0] - margin, low[1] - margin, high[0] + margin, high[1] + margin
        ground = [[left, front], [right, front], [right, back], [left, back]]
        self._log.static(
            f"{BUILDING}/ground",
            rr.Mesh3D(
                vertex_positions=[[*corner, low[2] - 0.15] for corner in ground],
                triangle_indices=[[0, 1, 2], [0, 2, 3]],
                vertex_normals=[[0, 0, 1]] * 4,
                albedo_factor=_GROUND,
            ),
        )
        tail = np.array([left + 0.45 * margin, front + margin, low[2]])
        north = np.array([0.0, margin, 0.0])
        self._log.static(
            f"{BUILDING}/north",
            rr.Arrows3D(origins=[tail], vectors=[1.5 * north], radii=[0.06 * margin], colors=[_NORTH]),
        )
        self._log.static(
            f"{BUILDING}/north/label",
            rr.Points3D([tail + 1.9 * north], labels=["N"], colors=[_NORTH], radii=0.01, show_labels=True),
        )
        if self._model.storey_labels:
            self._log.static(
                f"{BUILDING}/storeys",
                rr.Points3D(
                    [position for _, position in self._model.storey_labels],
                    labels=[text for text, _ in self._model.storey_labels],
                    colors=[_NORTH],
                    radii=[0.01],
                    show_labels=True,
                ),
            )

    def _log_names(self, labels: Mapping[str, str]) -> None:
        """Log the names of the zones; of many, those of the largest."""
        areas = {zone.name: zone.floor_area_m2 for zone in self._geometry.zones}
        largest = sorted(self._model.zone_places, key=lambda name: -areas.get(name, 0.0))[:_MAX_NAMES]
        texts = [labels.get(name.casefold(), name) for name in largest]
        places = [self._model.zone_places[name] for name in largest]
        self._log.static(
            f"{BUILDING}/names",
            rr.Points3D(places, labels=texts, colors=[_NORTH] * len(texts), radii=0.01, show_labels=True),
        )

    def add(self, block: SampleBlock) -> None:
        """Log the colors and the sun's positions that the samples change."""
        changes = self._changes.select(block.times, block.deviations)
        for column, path in self._colored:
            rows, deviations = changes[column]
            if len(rows):
                colors = np.full((len(rows), 4), 255, np.uint8)
                colors[:, :3] = comfort_colors(deviations)
                packed = colors.astype(np.uint32) @ np.array([1 << 24, 1 << 16, 1 << 8, 1], np.uint32)
                self._log.columns(path, block, rr.Mesh3D.columns(albedo_factor=packed), rows)
        self._add_sun(block)

    def _add_sun(self, block: SampleBlock) -> None:
        periods = block.times.astype(np.int64) // (self._sun_period_s * 10**9)
        rows = np.flatnonzero(periods != np.concatenate([[self._sun_period], periods[:-1]]))
        self._sun_period = int(periods[-1])
        if not len(rows):
            return
        positions = [self._sun(block.times[row]) for row in rows]
        flat = np.array([position for position in positions if position is not None]).reshape(-1, 3)
        counts = [int(position is not None) for position in positions]
        self._log.columns(
            f"{BUILDING}/sun",
            block,
            rr.Points3D.columns(
                positions=flat, radii=[0.04 * self._model.radius_m] * len(flat), colors=[list(_SUN)] * len(flat)
            ).partition(counts),
            rows,
        )

    def _sun(self, time: np.datetime64) -> Floats | None:
        """Return where the sun is drawn, around the building; None below the horizon."""
        place = self._geometry
        azimuth, elevation = np.radians(
            sun_direction(place.latitude_deg, place.longitude_deg, place.time_zone_h, time.astype("M8[s]").item())
        )
        if elevation <= 0:
            return None
        direction = np.array(
            [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)]
        )
        position: Floats = self._model.center + 1.15 * self._model.radius_m * direction
        return position


def _mesh(part: Mesh, color: tuple[int, int, int, int] | None) -> rr.Mesh3D:
    shades = np.rint(255 * part.brightness).astype(np.uint8)
    return rr.Mesh3D(
        vertex_positions=part.positions.astype(np.float32),
        triangle_indices=part.triangles.astype(np.uint32),
        vertex_normals=part.normals.astype(np.float32),
        vertex_colors=np.stack([shades, shades, shades, np.full_like(shades, 255)], axis=1),
        albedo_factor=color,
    )
