"""A node that orchestrates a district."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from zenostat.bridge.alarms.rules import point_alarms, read_rules
from zenostat.bridge.faults import read_plan
from zenostat.bridge.node.fault_injection import FaultInjection
from zenostat.bridge.node.manifest import described_manifest
from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import PlantContext, PlantDescription, PlantFactory, Provenance
from zenostat.bridge.node.server import Observer
from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.cosim.file import DistrictFile, read_district
from zenostat.cosim.launch import PlantSet, input_files
from zenostat.cosim.plant import DistrictPlant, describe
from zenostat.topics.codec import validated
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.messages import Manifest, Seed
from zenostat.topics.yaml12 import read_text

CheckReward = Callable[[Manifest], None]

_FINISH_S = 6.0
"""Time that the nodes of the plants may take to end."""


class DistrictSettings(NodeSettings):
    """Settings of a node that orchestrates a district.

    Attributes:
        name: by default that of the file.
        district: the file.
        seed: of the first episode; None draws it.
    """

    district: Path
    seed: Seed | None = None
    name: str = ""
    affinity: Affinity = Affinity.OFF


def read_settings(settings: Mapping[str, Any]) -> DistrictSettings:
    """Validate settings; those that are None count as left out.

    Raises:
        InvalidConfig: lists all errors.
    """
    fields = {name: value for name, value in settings.items() if value is not None or name == "deadline_s"}
    known = list(DistrictSettings.model_fields)
    if unknown := [
        f"a district has no setting {name!r}; {did_you_mean(name, known)}" for name in fields if name not in known
    ]:
        raise InvalidConfig("\n".join(unknown))
    config = validated(DistrictSettings, fields)
    if config.slots != 1 or config.baseline:
        raise InvalidConfig("a district has one slot and no baseline; leave out slots and baseline")
    return config


class DistrictNode(Node):
    """The node of a district; the nodes of its plants end with it.

    Args:
        settings: of the node.
        file: the district's file.
        observer, program: see `zenostat.bridge.node.node.Node`.
        check_reward: see `district_node`.

    Attributes:
        warnings: on the district, known as soon as its plants are open.
    """

    plant: DistrictPlant
    settings: DistrictSettings

    def __init__(
        self,
        settings: DistrictSettings,
        file: DistrictFile,
        observer: Observer | None = None,
        *,
        program: bool = False,
        check_reward: CheckReward | None = None,
    ) -> None:
        self._plants, self._file, self._check_reward = PlantSet(file), file, check_reward
        self.warnings: tuple[str, ...] = ()
        super().__init__(settings, self._open, observer, program=program, finish_s=_FINISH_S)

    def _open(self) -> PlantFactory:
        settings, file = self.settings, self._file
        binding = self._plants.open()
        provenance = Provenance("district", {}, input_files(file))
        description = describe(
            binding, settings.name, read_text(file.path), provenance, file.spec.reward, self._plants.systems()
        )
        self.warnings = description.warnings
        self._bind_reward(description)
        if settings.faults is not None:  # so that its errors are reported before the episode begins
            FaultInjection(read_plan(settings.faults), description, settings.slots)
        if settings.alarms is not None:
            point_alarms(read_rules(settings.alarms), description)

        def create(_: PlantContext) -> DistrictPlant:
            plants = self._plants.guarded()
            return DistrictPlant(binding, description, plants, file.spec.solver, self._plants.stop, settings.seed)

        return create

    def _bind_reward(self, description: PlantDescription) -> None:
        """Report a reward that does not fit the points, at its line."""
        if self._check_reward is None or description.task.reward is None:
            return
        try:
            self._check_reward(described_manifest(self.settings, description))
        except InvalidConfig as error:
            errors = self._file.errors()
            for line in str(error).splitlines():
                errors.add(("reward",), line)
            errors.raise_if_any()

    def check(self) -> None:
        """Check the settings and the file against the plants' points; the nodes that this needs are ended."""
        try:
            super().check()
        finally:
            self._plants.close()

    def close(self) -> None:
        """End the nodes of the plants, and leave the bus; idempotent."""
        super().close()
        self._plants.close()


def district_node(
    settings: DistrictSettings,
    observer: Observer | None = None,
    *,
    program: bool = False,
    check_reward: CheckReward | None = None,
) -> DistrictNode:
    """Return a node that is not started yet; see `zenostat.bridge.node.node.Node` for the other arguments.

    Args:
        settings: of the node.
        observer: see there.
        program: see there.
        check_reward: called with the district's manifest if it has a reward; raises `InvalidConfig` if it does not fit.

    Raises:
        InvalidConfig: the file cannot be read, or does not have the form of a district.

    Raises (on entering the node):
        UsageError, SimulatorError, BusError: see `zenostat.topics.errors`; everything that was started is closed.
    """
    file = read_district(settings.district)
    named = settings.model_copy(update={"name": settings.name or file.spec.name})
    return DistrictNode(named, file, observer, program=program, check_reward=check_reward)
