"""Journals of a run, one line of JSON or one msgpack map each, by whoever does it and as it does it."""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack

from zenostat.topics import codec
from zenostat.topics.messages import Event, Sample


class Journal:
    """A file that grows by whole lines: what was written is there, whatever then happens to its writer."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def note(self, **what: Any) -> None:
        """Adds a line."""
        os.write(self._file, json.dumps(what).encode() + b"\n")


def lines(path: Path) -> list[dict[str, Any]]:
    """All lines of a journal, in order."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


@dataclass(frozen=True, slots=True)
class Sent:
    """A command as its controller wrote it down before it sent it, `times` times.

    `values`: index of an actuator to its value, None where it is released; the others are kept.
    """

    name: str
    episode: int
    step: int
    times: int
    values: dict[int, float | None]


def sent(path: Path) -> list[Sent]:
    """All commands that a controller sent, in order."""
    return [
        Sent(line["name"], line["episode"], line["step"], line["times"], {int(i): v for i, v in line["values"]})
        for line in lines(path)
    ]


KINDS = ("sample", "event")
"""What the recording monitor writes down, by the last chunk of its key."""


def recorded(path: Path) -> Iterator[Sample | Event]:
    """Messages that the recording monitor received, in their order."""
    with path.open("rb") as file:
        for kind, payload in msgpack.Unpacker(file, max_buffer_size=0):
            yield codec.decode(Sample, payload) if kind == "sample" else codec.decode(Event, payload)
