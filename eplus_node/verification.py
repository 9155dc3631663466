"""Verify a recording: create the plant that was recorded, of either kind, and compare it with the recording."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from bridge.engine.registry import UNRESPONSIVE_S, EngineRegistry
from bridge.node.plant import PlantContext, PlantFactory, Provenance, RepeatablePlant, SlotPlacement
from bridge.recording.file import file_digest
from bridge.recording.reader import RecordingReader
from bridge.recording.verification import Progress, Verification, Verifier
from bridge.runtime.scratch import Scratch, sweep
from eplus_node.config import read_config
from eplus_node.plan import describe, plan
from eplus_node.plant import EnergyPlusPlant
from topics import VERSION, yaml12
from topics.errors import InvalidRecording, UsageError


def verify(path: str | Path, *, tolerance: float | None = None, progress: Progress | None = None) -> Verification:
    """Simulate a recording again with its orders, and compare all fault-free values, effective values and times.

    Args:
        path: of the recording.
        tolerance: greatest absolute difference that is accepted, in each point's unit, also where the model, the
            weather or EnergyPlus has changed; None: all have to be the same, and the values equal to the bit.
        progress: called with the number of timesteps so far and in total.

    Returns:
        The result; without a tolerance, up to the first difference.

    Raises:
        InvalidRecording: the file is not a recording, or what it recorded is not installed or has changed.
        SimulatorError: the simulator failed.
    """
    with ExitStack() as stack:
        reader = stack.enter_context(RecordingReader(path))
        try:
            factory, provenance = _factory(reader)
        except UsageError as error:
            raise InvalidRecording(f"what {path} recorded cannot be simulated here: {error}") from None
        changes = _changes(reader.provenance, provenance)
        if changes and tolerance is None:
            raise InvalidRecording(
                f"{path} cannot be verified to the bit: {'; '.join(changes)}; a tolerance compares it nevertheless"
            )
        sweep()
        scratch = Scratch()
        stack.callback(scratch.remove)
        slots, registry = reader.manifest.slots, EngineRegistry(UNRESPONSIVE_S)
        placement = (SlotPlacement(),) * slots
        context = PlantContext(scratch.folder, placement, baseline=reader.manifest.baseline, registry=registry)
        plant = factory(context)
        stack.callback(plant.close)
        assert isinstance(plant, RepeatablePlant)
        verifier = Verifier(reader, plant, scratch.folder / "copies", tolerance=tolerance, progress=progress)
        stack.callback(verifier.close)
        verifier.result.notes += changes
        recorded_version = reader.about.get("zenostat", "")
        if recorded_version != VERSION:
            verifier.result.notes.append(f"recorded by Zenostat {recorded_version}, verified by {VERSION}")
        return verifier.run()


def _factory(reader: RecordingReader) -> tuple[PlantFactory, Provenance]:
    """Return what creates the recorded plant, and what it is made of here."""
    kind, settings = reader.provenance.get("kind"), reader.provenance.get("settings", {})
    if kind == "energyplus":
        fields = yaml12.parse(reader.scenario, "its scenario") | settings
        planned = plan(read_config(fields))
        return partial(EnergyPlusPlant, planned), describe(planned).provenance
    if kind == "python":
        from bridge.python_plant.plant import PythonPlant, plan_class

        class_plan = plan_class(settings["plant"], settings["plant_arguments"], UNRESPONSIVE_S)
        return partial(PythonPlant, class_plan), class_plan.description.provenance
    raise InvalidRecording("its plant is neither a building nor a Python class that Zenostat started")


def _changes(recorded: Mapping[str, Any], present: Provenance) -> list[str]:
    """Return a text for each file whose content is not that of the recording."""
    files: Mapping[str, Any] = recorded.get("files", {})
    texts = []
    for role in dict.fromkeys((*files, *present.files)):
        if role not in present.files:
            texts.append(f"the {role} {files[role]['path']} is missing")
        elif role not in files:
            texts.append(f"the {role} {present.files[role]} was not there")
        elif file_digest(present.files[role]) != files[role]["sha256"]:
            texts.append(f"the {role} {present.files[role]} has changed")
    return texts
