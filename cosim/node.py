"""A node that orchestrates a district."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from zenostat.bridge.alarms.rules import point_alarms, read_rules
from zenostat.bridge.faults import read_plan
from zenostat.bridge.node.fault_injection import FaultInjection
from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import PlantContext, PlantFactory, Provenance
from zenostat.bridge.node.server import Observer
from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.cosim.file import DistrictFile, read_district
from zenostat.cosim.launch import PlantSet, input_files
from zenostat.cosim.plant import DistrictPlant, describe
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.yaml12 import read_text

_FINISH_S = 6.0
"""Time that the nodes of the plants may take to end."""


class DistrictSettings(NodeSettings):
    """Settings of a node that orchestrates a district.

    Attributes:
        name: by default that of the file.
        district: the file.
    """

    district: Path
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
    try:
        config = DistrictSettings.model_validate(fields)
    except ValidationError as error:
        raise InvalidConfig(describe_validation_errors(error)) from None
    if config.slots != 1 or config.baseline:
        raise InvalidConfig("a district has one slot and no baseline; leave out slots and baseline")
    return config


class DistrictNode(Node):
    """The node of a district; the nodes of its plants end with it.

    Args:
        settings: of the node.
        file: the district's file.
        observer, program: see `zenostat.bridge.node.node.Node`.
    """

    plant: DistrictPlant

    def __init__(
        self, settings: DistrictSettings, file: DistrictFile, observer: Observer | None = None, *, program: bool = False
    ) -> None:
        self._plants, self._file = PlantSet(file), file
        super().__init__(settings, self._open, observer, program=program, finish_s=_FINISH_S)

    def _open(self) -> PlantFactory:
        settings, file = self.settings, self._file
        binding = self._plants.open()
        provenance = Provenance("district", {}, input_files(file))
        description = describe(
            binding, settings.name, read_text(file.path), provenance, file.spec.reward, self._plants.systems()
        )
        if settings.faults is not None:  # so that its errors are reported before the episode begins
            FaultInjection(read_plan(settings.faults), description, settings.slots)
        if settings.alarms is not None:
            point_alarms(read_rules(settings.alarms), description)

        def create(_: PlantContext) -> DistrictPlant:
            return DistrictPlant(binding, description, self._plants.guarded(), file.spec.solver, self._plants.stop)

        return create

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
    settings: DistrictSettings, observer: Observer | None = None, *, program: bool = False
) -> DistrictNode:
    """Return a node that is not started yet; see `zenostat.bridge.node.node.Node` for the arguments.

    Raises:
        InvalidConfig: the file cannot be read, or does not have the form of a district.

    Raises (on entering the node):
        UsageError, SimulatorError, BusError: see `zenostat.topics.errors`; everything that was started is closed.
    """
    file = read_district(settings.district)
    named = settings.model_copy(update={"name": settings.name or file.spec.name})
    return DistrictNode(named, file, observer, program=program)
