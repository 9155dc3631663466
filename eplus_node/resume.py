"""A node that goes on with the recording of an ended one, from the recording alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zenostat.bridge.node.node import Node
from zenostat.bridge.node.plant import PlantFactory
from zenostat.bridge.node.server import Observer
from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.eplus_node.verify_recording import RecordedPlant
from zenostat.topics.codec import validated
from zenostat.topics.errors import InvalidRecording

RECORDED_SETTINGS = ("name", "mode", "speed", "policy", "grace_s", "deadline_s", "slots", "baseline")
"""Settings of a node that are those of the recorded one."""


def read_resumed(settings: Mapping[str, Any]) -> NodeSettings:
    """Return the settings of a node that goes on with the recording `resume`; the other settings may not be in it.

    Raises:
        InvalidRecording: it cannot be read, or is that of a district.
        InvalidConfig: a setting is not valid.
    """
    return validated(NodeSettings, {**settings, **recorded_settings(Path(settings["resume"]))})


def recorded_settings(path: Path) -> dict[str, Any]:
    """Return the settings of a recorded node, with which another one can go on.

    Raises:
        InvalidRecording: it cannot be read, or is that of a district.
    """
    with RecordingReader(path) as reader:
        manifest, kind = reader.manifest, reader.provenance.get("kind")
    if kind == "district":
        raise InvalidRecording(f"{path} recorded a district, and only a node with one plant can go on with a recording")
    return {name: getattr(manifest, name if name != "name" else "node") for name in RECORDED_SETTINGS}


def resumed_node(settings: NodeSettings, observer: Observer | None = None, *, program: bool = False) -> Node:
    """Return a node that is not started yet, with the recorded building; see `zenostat.bridge.node.node.Node`.

    Raises (on entering the node):
        InvalidRecording: it recorded a Python class, which only its user may name.
        UsageError, SimulatorError, BusError: see `zenostat.topics.errors`; everything that was started is closed.
    """
    assert settings.resume is not None

    def prepare() -> PlantFactory:
        assert settings.resume is not None
        with RecordingReader(settings.resume) as reader:
            factory, _ = RecordedPlant(reader, exact=False).factory(None, {})
        return factory

    return Node(settings, prepare, observer, program=program)
