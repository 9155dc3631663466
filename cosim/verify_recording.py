"""Verify the recording of a district: simulate it again from its file, and compare.

A recording is data of anybody, and nothing that it names is read or run: the user names the district's file.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from zenostat.bridge.node.plant import Provenance
from zenostat.bridge.recording.file import changed_files, recorded_digests
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.recording.verification import Progress, Verification, Verifier
from zenostat.bridge.runtime.scratch import scratch_folder, sweep
from zenostat.cosim.file import DistrictFile, read_district
from zenostat.cosim.launch import PlantSet, input_files
from zenostat.cosim.plant import DistrictPlant, describe
from zenostat.topics.errors import InvalidRecording


def verify_district(
    path: str | Path, district: Path, *, tolerance: float | None = None, progress: Progress | None = None
) -> Verification:
    """Simulate the recording of a district again with its orders, and compare all values and times.

    A plant that was lost while the others went on is lost in the same steps, and comes back in the same one.

    Args:
        path: of the recording.
        district: the district's file.
        tolerance: greatest absolute difference that is accepted; None: the district's file, and those that it names,
            have to be the recorded ones, and all values are equal to the bit.
        progress: called with the number of timesteps so far and in total.

    Returns:
        The result; without a tolerance, up to the first difference.

    Raises:
        InvalidRecording: the file is no recording of a district, or the district has changed.
        InvalidConfig: the district's file is not valid.
        SimulatorError, BusError: a plant cannot be started, or failed.
    """
    with ExitStack() as stack:
        reader = stack.enter_context(RecordingReader(path))
        provenance = reader.provenance
        if provenance.get("kind") != "district":
            raise InvalidRecording(f"{path} did not record a district; leave --district out")
        file = read_district(district)
        changes = _changes(reader, file, exact=tolerance is None)
        sweep()
        folder = stack.enter_context(scratch_folder())
        plants = PlantSet(file)
        stack.callback(plants.close)
        binding = plants.open()
        description = describe(binding, file.spec.name, "", Provenance())
        plant = DistrictPlant(binding, description, plants.guarded(repeat=True), file.spec.solver, plants.stop)
        stack.callback(plant.close)
        verifier = Verifier(reader, plant, folder / "copies", tolerance=tolerance, progress=progress)
        stack.callback(verifier.close)
        verifier.result.notes += changes
        result = verifier.run()
        result.notes += [
            f"plant {name!r} was lost in {count} step{'s' if count > 1 else ''} by the recording; its last values held"
            for name, count in plant.lost_steps.items()
            if count
        ]
        return result


def _changes(reader: RecordingReader, file: DistrictFile, *, exact: bool) -> list[str]:
    """Return a text for each file whose content is not the recorded one; raise if exact."""
    return changed_files(
        reader.path,
        recorded_digests(reader.provenance),
        input_files(file),
        exact=exact,
        missing=lambda role: f"the {role} of the recording is not in {file.path}",
    )
