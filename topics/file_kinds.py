"""Kinds of YAML files, by their fields: a file that was given to the wrong command is one sentence."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

from zenostat.topics.errors import InvalidConfig


class FileKind(StrEnum):
    """A kind of YAML file."""

    SCENARIO = "scenario"
    TRAINING = "training"
    TUNING = "tuning"
    CONTROLLER = "controller"
    CALIBRATION = "calibration"
    DISTRICT = "district"


_FIELDS = {
    FileKind.SCENARIO: {"building", "weather", "sensors", "actuators"},
    FileKind.TRAINING: {"algorithm", "scenario", "steps", "normalization"},
    FileKind.TUNING: {"study", "training", "sampler", "trials"},
    FileKind.CONTROLLER: {"controller"},
    FileKind.CALIBRATION: {"timestamps", "periods", "held_out", "columns", "margin"},
    FileKind.DISTRICT: {"plants", "connections", "lost_timeout"},
}
"""Fields that only files of one kind have, at least one of which is required."""

_COMMANDS = {
    FileKind.SCENARIO: "give it to zenostat evaluate, or as the `scenario` of a training file",
    FileKind.TRAINING: "use zenostat train",
    FileKind.TUNING: "use zenostat tune",
    FileKind.CONTROLLER: "give it to zenostat run or evaluate as --controller",
    FileKind.CALIBRATION: "use zenostat calibrate",
    FileKind.DISTRICT: "use zenostat cosim, whose recordings zenostat report compares",
}


def check_file_kind(fields: Iterable[str], expected: FileKind, what: str) -> None:
    """Check that a file is not of another kind than the expected one.

    Args:
        fields: names of the file's fields.
        expected: the kind that is expected.
        what: the file, for the error.

    Raises:
        InvalidConfig: it has fields of another kind and none of the expected one; the text names the right command.
    """
    names = set(fields)
    counts = {kind: len(names & own) for kind, own in _FIELDS.items()}
    kind = max(counts, key=counts.__getitem__)
    if counts[kind] and not counts[expected]:
        raise InvalidConfig(f"{what} is a {kind} file, not a {expected} file: {_COMMANDS[kind]}")
