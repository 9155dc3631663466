"""The views of one episode of one node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
import rerun as rr

from bridge.display.roles import PointRoles
from bridge.rerun.building_view import BuildingView
from bridge.rerun.carpet import CarpetView
from bridge.rerun.meshes import BuildingModel
from bridge.rerun.recording import EpisodeLog, entity_path
from bridge.rerun.samples import BlockReader, Comfort, Floats, RewardTerms, SampleBlock
from bridge.rerun.series import REWARD, Lines, Series, all_series, reward_lines, significant_rows, vectors
from bridge.rerun.summary import MAX_TEXTS, NUMBERS, NodeNumbers, markdown, numbers_at
from bridge.rerun.timelines import SourceTimelines, ZoneTimelines
from bridge.rerun.totals import Totals
from topics.messages import Geometry, Manifest, Sample

MAX_TIMELINE_ZONES = 20
MAX_TIMELINE_DAYS = 14.5
"""Most zones and days that a state timeline shows; more are a carpet."""


@dataclass(frozen=True, eq=False)
class NodeModel:
    """What all episodes of a node share.

    Attributes:
        manifest: of the node.
        roles: of its points.
        comfort: its zones' comfort bands; None without zone temperatures.
        geometry, building: its geometry and the meshes of it; None for a plant without one.
    """

    manifest: Manifest
    roles: PointRoles
    comfort: Comfort | None
    geometry: Geometry | None = None
    building: BuildingModel | None = None

    @property
    def has_carpet(self) -> bool:
        """Whether zones over time are an image instead of state timelines."""
        days = self.manifest.steps * self.manifest.step_s / 86400
        return len(self.roles.zones) > MAX_TIMELINE_ZONES or days > MAX_TIMELINE_DAYS


class EpisodeView:
    """Logs the samples of an episode: plots, timelines, the building and the numbers.

    Args:
        recording: where to log.
        node: what all episodes of the node share.
        episode: number of the episode.
        reward: the reward terms of the episode; None without a reward.
        status: returns the connected controllers and the active faults.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        node: NodeModel,
        episode: int,
        reward: RewardTerms | None,
        status: Callable[[], tuple[tuple[str, ...], tuple[str, ...]]],
    ) -> None:
        self._node, self._status, self._reward = node, status, reward
        manifest, roles, comfort = node.manifest, node.roles, node.comfort
        self.log = EpisodeLog(recording, entity_path(manifest.node, f"episode_{episode:04}"))
        self.series = all_series(manifest, roles, has_comfort=comfort is not None)
        for series in self.series:
            self.log.static(series.path, series.style())
        self.numbers = NodeNumbers()
        self.reward: Lines | None = None  # known at the first timestep
        self._reader = BlockReader(manifest, roles, comfort)
        self._totals = Totals(manifest, roles)
        self._since: datetime | None = None
        self._stride = max(1, manifest.steps // MAX_TEXTS)
        self._last: tuple[SampleBlock, int] | None = None
        by_temperature = {zone.temperature: zone for zone in roles.zones}
        zones = [] if comfort is None else [by_temperature[index] for index in comfort.zones.tolist()]
        names = [zone.label for zone in zones]
        self._sources = SourceTimelines(self.log, roles.actuator_labels)
        self._zone_rows = ZoneTimelines(self.log, names) if zones and not node.has_carpet else None
        self._carpet = None
        if zones and node.has_carpet:
            begin = np.datetime64(manifest.begin, "s")
            self._carpet = CarpetView(self.log, names, manifest.steps, begin, manifest.step_s)
        self._building = None
        if node.building is not None and node.geometry is not None:
            labels = [(zone.key, zone.label) for zone in zones]
            self._building = BuildingView(self.log, node.building, node.geometry, labels)

    def add(self, samples: Sequence[Sample]) -> None:
        """Log consecutive samples."""
        block = self._reader.block(samples)
        totals = self._totals.add(block)
        for series in self.series:
            self._add_series(series, block, series.compute(block, totals))
        self._sources.add(block)
        if self._zone_rows is not None:
            self._zone_rows.add(block)
        if self._carpet is not None:
            self._carpet.add(block)
        if self._building is not None:
            self._building.add(block)
        if self._reward is not None:
            self._add_reward(self._reward, block)
        if self._since is None:
            self._since = block.times[0].astype("M8[s]").item()
        rows = np.flatnonzero(block.steps % self._stride == 0)
        rows = rows if len(rows) and rows[-1] == len(block) - 1 else np.append(rows, len(block) - 1)
        all_numbers = [numbers_at(int(row), block, totals, self._node.roles, self._since) for row in rows]
        controllers, faults = self._status()
        for numbers in all_numbers:
            numbers.controllers, numbers.faults = controllers, faults
        self.numbers = all_numbers[-1]
        self._add_texts(block, rows, all_numbers)

    def _add_series(self, series: Series, block: SampleBlock, table: Floats) -> None:
        rows = significant_rows(table) if series.is_sparse else np.arange(len(table))
        self.log.columns(series.path, block, vectors(table[rows]), rows)

    def _add_reward(self, reward: RewardTerms, block: SampleBlock) -> None:
        rows = np.flatnonzero(block.steps > 0)
        if not len(rows):
            return
        timestep = timedelta(seconds=self._node.manifest.step_s)
        begins = [time - timestep for time in block.times[rows].astype("M8[us]").tolist()]
        terms = [reward(block.values[row], begin) for row, begin in zip(rows, begins, strict=True)]
        if self.reward is None:
            self.reward = reward_lines(tuple(terms[0]))
            self.log.static(REWARD, self.reward.style())
        table = np.array([[float(value) for value in row.values()] for row in terms])
        self.log.columns(REWARD, block, vectors(table), rows)

    def _add_texts(self, block: SampleBlock, rows: np.ndarray, numbers: Sequence[NodeNumbers]) -> None:
        texts = [markdown(entry) for entry in numbers]
        columns = rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
        self.log.columns(NUMBERS, block, columns, rows)

    def draw(self) -> None:
        """Log the image of the zones over time, which is too large to be logged with each block."""
        if self._carpet is not None:
            self._carpet.draw()
