"""The views of one episode of one node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from zenostat.metrics.comfort import Comfort
from zenostat.metrics.roles import PointRoles
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Geometry, Manifest, Sample
from zenostat.views.live.building_view import BuildingView
from zenostat.views.live.carpet import CarpetView
from zenostat.views.live.comfort_scale import ComfortScale
from zenostat.views.live.grid_series import grid_series
from zenostat.views.live.meshes import BuildingModel
from zenostat.views.live.recording import EpisodeLog, episode_path
from zenostat.views.live.samples import BlockReader, RewardTerms, SampleBlock
from zenostat.views.live.series import REWARD, Lines, Series, all_series, reward_lines, vectors
from zenostat.views.live.summary import NUMBERS, NodeNumbers, NodeStatus, markdown, numbers_of
from zenostat.views.live.totals import TotalRows, Totals
from zenostat.views.live.value_sources import SourcesView

LONG_DAYS = 31.0
"""Length of an episode from which the sun's position is logged less often."""

_MARKDOWN = "text/markdown"


@dataclass(frozen=True, eq=False)
class NodeModel:
    """Properties that all episodes of a node share.

    Attributes:
        manifest: of the node.
        roles: of its points.
        comfort: its zones' comfort bands; None without zone temperatures.
        geometry, building: its geometry and the meshes of it; None for a plant without one.
        run: number of the node among those of its name, from 1.
    """

    manifest: Manifest
    roles: PointRoles
    comfort: Comfort | None
    geometry: Geometry | None = None
    building: BuildingModel | None = None
    run: int = 1

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
        self, recording: rr.RecordingStream, node: NodeModel, episode: int, reward: RewardTerms | None
    ) -> None:
        self._node, self._reward = node, reward
        manifest, roles, comfort = node.manifest, node.roles, node.comfort
        self.log = EpisodeLog(recording, episode_path(manifest.node, episode, node.run), manifest.begin)
        self.series = [*all_series(manifest, roles, has_comfort=comfort is not None), *grid_series(manifest)]
        for series in self.series:
            self.log.static(series.path, series.style())
        self.numbers = NodeNumbers()
        self._latest: tuple[NDArray[np.datetime64], NDArray[np.int64]] | None = None  # time and step of `numbers`
        self.log.static(NUMBERS, rr.TextDocument.from_fields(media_type=_MARKDOWN))
        self.reward: Lines | None = None  # known at the first timestep
        self._reader = BlockReader(manifest, comfort)
        self._totals = Totals(manifest, roles)
        by_temperature = {zone.temperature: zone for zone in roles.zones}
        zones = [] if comfort is None else [by_temperature[index] for index in comfort.zones.tolist()]
        names = [zone.label for zone in zones]
        self._pictures: list[SourcesView | CarpetView] = []  # they are too large to be logged with each block
        if manifest.actuators:
            self._pictures.append(SourcesView(self.log, roles.actuator_labels, manifest))
        if zones:
            self._pictures.append(CarpetView(self.log, names, manifest))
        self._scale = ComfortScale(self.log) if zones else None
        self._building = None
        if node.building is not None and node.geometry is not None:
            labels = [(zone.key, zone.label) for zone in zones]
            is_long = node.days > LONG_DAYS
            self._building = BuildingView(self.log, node.building, node.geometry, labels, is_long=is_long)

    def add(self, samples: Sequence[Sample], statuses: Sequence[NodeStatus]) -> None:
        """Log consecutive samples, each with the node's status at its step."""
        self._add(self._reader.block(samples), statuses)

    def add_history(self, first_step: int, table: Floats) -> None:
        """Log consecutive samples of the node's history; see `BlockReader.history_block`."""
        block = self._reader.history_block(self._node.manifest, first_step, table)
        self._add(block, [NodeStatus()] * len(block))

    def _add(self, block: SampleBlock, statuses: Sequence[NodeStatus]) -> None:
        totals = self._totals.add(block)
        for series in self.series:
            self._add_series(series, block, series.compute(block, totals))
        for picture in self._pictures:
            picture.add(block)
        if self._scale is not None:
            self._scale.add(block)
        if self._building is not None:
            self._building.add(block)
        if self._reward is not None:
            self._add_reward(self._reward, block)
        self._add_numbers(block, totals, statuses)

    def _add_numbers(self, block: SampleBlock, totals: TotalRows, statuses: Sequence[NodeStatus]) -> None:
        shown = numbers_of(block, totals, self._node.roles, statuses)
        self.numbers = shown[-1]
        self._latest = (block.times[-1:], block.steps[-1:])
        self.log.columns(NUMBERS, block, rr.TextDocument.columns(text=list(map(markdown, shown))))

    def set_status(self, status: NodeStatus) -> None:
        """Log the numbers of the newest sample again, with the status that was announced after it."""
        if self._latest is not None:
            self.numbers.alarms, self.numbers.faults = status
            self.log.columns_at(NUMBERS, *self._latest, rr.TextDocument.columns(text=[markdown(self.numbers)]))

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
        """Log the pictures of all that was added."""
        for picture in self._pictures:
            picture.draw()
