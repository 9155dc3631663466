"""Verify a recording: create the plant that was recorded, of either kind, and compare it with the recording.

A recording is data of anybody. Nothing that it names is imported or run: a building is simulated by the installed
EnergyPlus, and a Python class is the one that the user names. Digests are compared before either starts.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zenostat.bridge.engine.registry import UNRESPONSIVE_S, EngineRegistry
from zenostat.bridge.node.plant import PlantContext, PlantFactory, RepeatablePlant, SlotPlacement
from zenostat.bridge.recording.file import changed_files, file_digest
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.recording.verification import Progress, Verification, Verifier
from zenostat.bridge.runtime.scratch import scratch_folder, sweep
from zenostat.eplus_node.config import NodeConfig, read_config, scenario_of
from zenostat.eplus_node.plan import REPEATED_SETTINGS, input_files, plan
from zenostat.eplus_node.plant import EnergyPlusPlant
from zenostat.models import catalog
from zenostat.models.building.external_files import files_by_role, is_external
from zenostat.models.building.model import Building, read_building, with_edits
from zenostat.models.scenario.schema import Scenario
from zenostat.models.semantic.graph import semantic_turtle
from zenostat.topics import yaml12
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig, InvalidRecording, UsageError
from zenostat.topics.messages import Lines


def verify(
    path: str | Path,
    *,
    plant: str | None = None,
    fmu: str | Path | None = None,
    grid: str | Path | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Simulate a recording again with its orders, and compare all fault-free values, effective values and times.

    Args:
        path: of the recording.
        plant: for the recording of a Python class: the class, as `FILE.py:CLASS` or `MODULE:CLASS`. The one that the
            recording names is never imported. It is defined in that file, which has the recorded digest (with a
            tolerance, a note says that it differs); it receives the recorded arguments.
        fmu: for the recording of an FMU: its file, which has the recorded digest.
        grid: for the recording of an electric grid: its file.
        tolerance: greatest absolute difference that is accepted, in each point's unit, also where the model, the
            weather or EnergyPlus has changed; None: all have to be the same, and the values equal to the bit.
        progress: called with the number of timesteps so far and in total.

    Returns:
        The result; without a tolerance, up to the first difference.

    Raises:
        InvalidRecording: the file is not a recording, or what it recorded is not installed or has changed.
        InvalidConfig: `plant` names no class, or one that another file defines; or two plants are named.
        SimulatorError: the simulator failed.
    """
    with ExitStack() as stack:
        reader = stack.enter_context(RecordingReader(path))
        factory, changes = RecordedPlant(reader, exact=tolerance is None).factory(plant, {"fmu": fmu, "grid": grid})
        sweep()
        folder = stack.enter_context(scratch_folder())
        slots, registry = reader.manifest.slots, EngineRegistry(UNRESPONSIVE_S)
        placement = (SlotPlacement(),) * slots
        context = PlantContext(folder, placement, baseline=reader.manifest.baseline, registry=registry)
        new_plant = factory(context)
        stack.callback(new_plant.close)
        assert isinstance(new_plant, RepeatablePlant)
        verifier = Verifier(reader, new_plant, folder / "copies", tolerance=tolerance, progress=progress)
        stack.callback(verifier.close)
        verifier.result.notes += changes
        return verifier.run()


class _RecordedFile(BaseModel):
    path: Lines
    sha256: str


class _Provenance(BaseModel):
    """The recorded provenance; see `zenostat.bridge.node.plant.Provenance`."""

    model_config = ConfigDict(extra="ignore")

    kind: Literal["", "energyplus", "python", "district"] = ""
    settings: dict[str, Any] = Field(default_factory=dict)
    files: dict[str, _RecordedFile] = Field(default_factory=dict)


class RecordedPlant:
    """Description of the plant in a recording, none of which is trusted.

    Args:
        reader: of the recording.
        exact: files that differ from the recorded ones are an error; otherwise, they are changes.
    """

    def __init__(self, reader: RecordingReader, *, exact: bool) -> None:
        self._reader, self._path, self._exact = reader, reader.path, exact
        try:
            self._provenance = _Provenance.model_validate(reader.provenance)
        except ValidationError as error:
            raise InvalidRecording(
                f"{self._path} is damaged: its provenance: {describe_validation_errors(error)}"
            ) from None

    def factory(self, plant: str | None, sources: Mapping[str, str | Path | None]) -> tuple[PlantFactory, list[str]]:
        """Return what creates the plant, and what has changed since; nothing of it has run.

        Args:
            plant: as in `verify`.
            sources: the files of plants that come with Zenostat, by their option.
        """
        kind = self._provenance.kind
        named = {option: str(source) for option, source in {"plant": plant, **sources}.items() if source is not None}
        if len(named) > 1:
            raise InvalidConfig(f"--{' and --'.join(named)} both name the plant; use the one that was recorded")
        if kind == "python":
            return self._python_class(named)
        if kind == "district":
            raise InvalidRecording(f"{self._path} recorded a district; name its file, as in --district district.yaml")
        for option, source in named.items():
            raise InvalidConfig(f"--{option} {source}: {self._path} recorded a building; leave --{option} out")
        if kind == "energyplus":
            try:
                return self._building()
            except UsageError as error:
                if isinstance(error, InvalidRecording):
                    raise
                raise InvalidRecording(f"what {self._path} recorded cannot be simulated here: {error}") from None
        raise InvalidRecording("its plant is neither a building nor a Python class that Zenostat started")

    def semantic_turtle(self, node: str) -> str:
        """Return the semantic model of the recorded building as Turtle, with references to the points of a node.

        It is that of the recorded node, if this has its name. The points are those of the recorded manifest; zones,
        loops and equipment are those of the model. It simulates nothing.

        Args:
            node: name of the node.

        Raises:
            InvalidRecording: see `building`.
        """
        return semantic_turtle(self.building(), node, self._reader.manifest)

    def building(self) -> Building:
        """Read the model of the recorded building again, with the recorded edits.

        Raises:
            InvalidRecording: it recorded no building, or its model is missing or has changed.
        """
        kind = self._provenance.kind
        if kind != "energyplus":
            what = {"python": "a Python class", "district": "a district"}.get(kind, "a plant of an own program")
            raise InvalidRecording(f"{self._path} recorded {what}, which has no semantic model")
        try:
            scenario = scenario_of(self._building_config())
            entry = catalog.find_building(scenario.building)
            self._check_model(entry.path)
            return with_edits(read_building(entry), scenario.edits)
        except UsageError as error:
            if isinstance(error, InvalidRecording):
                raise
            recorded = self._provenance.files.get("model")
            file = f", {recorded.path}" if recorded else ""
            raise InvalidRecording(
                f"{self._path} has no semantic model without the model that it recorded{file}: {error}"
            ) from None

    def _check_model(self, file: Path) -> None:
        """Check that a model is the recorded one."""
        recorded = self._provenance.files.get("model")
        if recorded is None:
            raise InvalidRecording(f"{self._path} has no digest of its model, so it has no semantic model")
        if file_digest(file) != recorded.sha256:
            raise InvalidRecording(
                f"{self._path} has no semantic model without the model that it recorded: {file} has changed since; "
                f"expected the content with SHA-256 {recorded.sha256}"
            )

    def _building(self) -> tuple[PlantFactory, list[str]]:
        config = self._building_config()
        external = {role for role in self._provenance.files if is_external(role)}
        files = input_files(config)
        changes = self._changes(files, roles={*self._provenance.files, *files} - external)
        planned = plan(config)
        changes += self._changes(files_by_role(planned.building.objects), roles=external)
        return partial(EnergyPlusPlant, planned), changes

    def _building_config(self) -> NodeConfig:
        """Return the recorded scenario and the settings that a recording may repeat."""
        settings = self._provenance.settings
        self._check_names(settings, REPEATED_SETTINGS)
        scenario = yaml12.parse(self._reader.scenario, "its scenario")
        self._check_names(scenario, tuple(Scenario.model_fields))
        return read_config(scenario | settings)

    def _check_names(self, settings: Mapping[str, Any], known: Sequence[str]) -> None:
        if foreign := [name for name in settings if name not in known]:
            raise InvalidRecording(f"{self._path} is damaged: no recording has the setting {', '.join(foreign)}")

    def _python_class(self, named: Mapping[str, str]) -> tuple[PlantFactory, list[str]]:
        from zenostat.bridge.python_plant.class_file import class_file
        from zenostat.bridge.python_plant.class_plan import plan_class
        from zenostat.bridge.python_plant.plant import PythonPlant
        from zenostat.bridge.python_plant.shipped import SHIPPED, shipped_option, shipped_plant

        recorded, arguments = self._provenance.settings.get("plant"), self._provenance.settings.get("plant_arguments")
        if not isinstance(recorded, str) or not isinstance(arguments, dict):
            raise InvalidRecording(f"{self._path} is damaged: its provenance names no class and arguments")
        option = shipped_option(recorded)
        if option is not None:
            if option not in named:
                raise InvalidRecording(
                    f"{self._path} recorded the {option} {arguments.get('file')!r}; nothing that a recording names is "
                    f"run: name it yourself, as in --{option} FILE (verify(..., {option}=...))"
                )
            plant, arguments = shipped_plant(option, named[option], _without_file(arguments))
        elif "plant" not in named:
            raise InvalidRecording(
                f"{self._path} recorded the Python class {recorded!r}; no code that a recording names is run: name the "
                f"class yourself, as in --plant tank.py:Tank (verify(..., plant=...))"
            )
        else:
            plant = named["plant"]
        file, name = class_file(plant), recorded.rpartition(":")[2]
        if option is None and file in {class_file(shipped) for shipped in SHIPPED.values()}:
            raise InvalidConfig(f"--plant {plant}: {self._path} recorded the Python class {recorded!r}")
        renamed = [] if plant.endswith(f":{name}") else [f"the class {plant} is not the recorded {name}"]
        code = {"class": file, **({"fmu": Path(arguments["file"])} if option == "fmu" else {})}
        changes = self._changes(code, renamed, roles=code)  # before anything of it runs
        class_plan = plan_class(plant, arguments, UNRESPONSIVE_S, own_class=True)
        rest = {role: path for role, path in class_plan.description.provenance.files.items() if role not in code}
        changes += self._changes(rest, roles={*self._provenance.files, *rest} - code.keys())
        return partial(PythonPlant, class_plan), changes

    def _changes(
        self, present: Mapping[str, Path], changes: Sequence[str] = (), *, roles: Collection[str] | None = None
    ) -> list[str]:
        """Return a text for each file whose content is not the recorded one, after `changes`; raise if exact.

        Args:
            present: files by their role.
            changes: further texts.
            roles: those that are compared; by default all.
        """
        recorded = self._provenance.files
        selected = {*recorded, *present} if roles is None else roles
        return changed_files(
            self._path,
            {role: file.sha256 for role, file in recorded.items() if role in selected},
            {role: path for role, path in present.items() if role in selected},
            changes,
            exact=self._exact,
            missing=lambda role: f"the {role} {recorded[role].path} is missing",
        )


def _without_file(arguments: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in arguments.items() if name != "file"}
