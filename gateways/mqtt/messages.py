"""Payloads of the gateway's topics: values and samples as JSON, commands and their results."""

from __future__ import annotations

import json
from math import isnan
from typing import Any

from zenostat.bridge.client.sample import SampleView
from zenostat.gateways.points import Reading, effective_value
from zenostat.topics import codec
from zenostat.topics.errors import BadMessage, ZenostatError
from zenostat.topics.keys import MAX_NAME
from zenostat.topics.messages import Event, Manifest, Write
from zenostat.topics.printable import replace_controls

MAX_PAYLOAD_BYTES = 4096
"""Largest payload of a command."""


def read_command(payload: bytes, *, priority: int, source: str) -> Write:
    """Return the write of a payload: a number, JSON with the fields of `Write`, or nothing, which relinquishes.

    Args:
        payload: of the topic `…/set`.
        priority: priority of a command that names none.
        source: name of the writer where the command names none.

    Raises:
        BadMessage: it is neither, or a field is invalid; the actuator's bounds are checked by the node.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise BadMessage(f"a payload of {len(payload)} bytes; at most {MAX_PAYLOAD_BYTES} are accepted")
    try:
        content: Any = json.loads(payload) if payload.strip() else None
    except (ValueError, RecursionError):
        shown = repr(payload[:80].decode("utf-8", "replace"))
        raise BadMessage(f'{shown} is neither a number nor JSON such as {{"value": 26.5}}') from None
    fields = content if isinstance(content, dict) else {"value": content}
    return codec.validated(Write, {"priority": priority, "source": source, **fields}, error=BadMessage)


def accepted(command: Write, text: str, episode: int, step: int) -> str:
    """Return the result of an accepted command as JSON."""
    return json.dumps({"accepted": True, "value": command.value, "message": text, "episode": episode, "step": step})


def rejected(error: ZenostatError) -> str:
    """Return the result of a rejected command as JSON: the class of the error and its text."""
    return json.dumps({"accepted": False, "error": type(error).__name__, "message": str(error)})


def number(value: float | None) -> str:
    """Return a value as JSON: the shortest decimal number that is equal to it, or null."""
    return "null" if value is None or isnan(value) else json.dumps(value)


def sample_json(sample: SampleView, readings: list[Reading]) -> str:
    """Return a sample as JSON: episode, step, time, and the values, effective values and sources by name."""
    manifest = sample.manifest
    return json.dumps(
        {
            "episode": sample.episode,
            "step": sample.step,
            "time": sample.time.isoformat(),
            "last": sample.truncated,
            "values": {reading.name: reading.of(sample) for reading in readings},
            "effective": {a.name: effective_value(sample, index) for index, a in enumerate(manifest.actuators)},
            "sources": sample.value_source,
        }
    )


def event_json(event: Event) -> str:
    """Return an event as JSON, with the fields of the bus."""
    return json.dumps(event.model_dump(mode="json"))


def read_manifest(payload: bytes) -> tuple[str, str] | None:
    """Return the node and its instance in a manifest that is stored on a broker; None if it is none."""
    try:
        content = json.loads(payload)
        return replace_controls(str(content["node"])[:MAX_NAME]), str(content["instance"])
    except (ValueError, RecursionError, LookupError, TypeError):
        return None


def manifest_json(manifest: Manifest, readings: list[Reading]) -> str:
    """Return names, units and bounds of all points as JSON."""
    return json.dumps(
        {
            "node": manifest.node,
            "instance": manifest.instance,
            "building": manifest.building,
            "timestep_s": manifest.step_s,
            "readings": [{"name": reading.name, "unit": reading.unit} for reading in readings],
            "actuators": [{"name": a.name, "unit": a.unit, "low": a.low, "high": a.high} for a in manifest.actuators],
        }
    )
