"""The views of one episode of one node."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

import numpy as np
import rerun as rr

from bridge.display.comfort import Comfort
from bridge.display.roles import PointRoles
from bridge.rerun.building_view import BuildingView
from bridge.rerun.carpet import CarpetView
from bridge.rerun.meshes import BuildingModel
from bridge.rerun.recording import EpisodeLog, entity_path
from bridge.rerun.samples import BlockReader, Floats, RewardTerms, SampleBlock
from bridge.rerun.series import REWARD, Lines, Series, all_series, reward_lines, vectors
from bridge.rerun.summary import MAX_TEXTS, NUMBERS, NodeNumbers, NodeStatus, markdown, numbers_at
from bridge.rerun.timelines import SourceTimelines, ZoneTimelines
from bridge.rerun.totals import TotalRows, Totals
from topics.messages import Geometry, Manifest, Sample

LONG_DAYS = 31.0
"""Length of an episode from which the sun's position is logged less often."""

_TEXT_PERIOD_S = 0.3
_MARKDOWN = "text/markdown"

MAX_TIMELINE_ZONES = 20
MAX_TIMELINE_DAYS = 14.5
"""Most zones and days that a state timeline shows; more are a carpet."""


@dataclass(frozen=True, eq=False)
class NodeModel:
    """Properties that all episodes of a node share.

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
        return len(self.roles.zones) > MAX_TIMELINE_ZONES or self.days > MAX_TIMELINE_DAYS

    @property
    def days(self) -> float:
        """Length of an episode in days."""
        return self.manifest.steps * self.manifest.step_s / 86400


class EpisodeView:
    """Logs the samples of an episode: plots, timelines, the building and the numbers.

    Args:
        recording: where to log.
        node: what all episodes of the node share.
        episode: number of the episode.
        reward: the reward terms of the episode; None without a reward.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        node: NodeModel,
        episode: int,
        reward: RewardTerms | None,
    ) -> None:
        self._node, self._reward = node, reward
        manifest, roles, comfort = node.manifest, node.roles, node.comfort
        self.log = EpisodeLog(recording, entity_path(manifest.node, f"episode_{episode:04}"))
        self.series = all_series(manifest, roles, has_comfort=comfort is not None)
        for series in self.series:
            self.log.static(series.path, series.style())
        self.numbers = NodeNumbers()
        self.reward: Lines | None = None  # known at the first timestep
        self._reader = BlockReader(manifest, comfort)
        self._totals = Totals(manifest, roles)
        self._stride = -(-manifest.steps // MAX_TEXTS) or 1
        self._text_s = 0.0
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
            is_long = node.days > LONG_DAYS
            self._building = BuildingView(self.log, node.building, node.geometry, labels, is_long=is_long)

    def add(self, samples: Sequence[Sample], statuses: Sequence[NodeStatus]) -> None:
        """Log consecutive samples, each with the node's status when it was received."""
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
        self._add_numbers(block, totals, statuses)

    def _add_numbers(self, block: SampleBlock, totals: TotalRows, statuses: Sequence[NodeStatus]) -> None:
        """Log the numbers at regular steps, at the end and, a few times a second, those of the newest sample."""
        is_regular = (block.steps % self._stride == 0) | (block.steps == self._node.manifest.steps)
        rows, last, now_s = np.flatnonzero(is_regular).tolist(), len(block) - 1, time.monotonic()
        if now_s - self._text_s > _TEXT_PERIOD_S and last not in rows:
            rows.append(last)
        shown = [numbers_at(row, block, totals, self._node.roles, statuses[row]) for row in rows]
        self.numbers = shown[-1] if last in rows else numbers_at(last, block, totals, self._node.roles, statuses[last])
        if rows:
            self._text_s = now_s
            columns = rr.TextDocument.columns(text=list(map(markdown, shown)), media_type=[_MARKDOWN] * len(rows))
            self.log.columns(NUMBERS, block, columns, np.array(rows, np.intp))

    def _add_series(self, series: Series, block: SampleBlock, table: Floats) -> None:
        rows = series.rows(block.steps, table, self._node.manifest.steps)
        if len(rows):
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

    def draw(self) -> None:
        """Log the image of the zones over time, which is too large to be logged with each block."""
        if self._carpet is not None:
            self._carpet.draw()
