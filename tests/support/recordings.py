"""Recordings for tests: a copy of one with a payload changed, and the places where its chunks end."""

import itertools
import json
import os
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode

from zenostat.agent_sdk.testing import FakeEnv
from zenostat.bridge.node.plant import PlantDescription, RunPeriod
from zenostat.bridge.recording.audit_chain import AuditChain
from zenostat.bridge.recording.channels import AUDIT, CHANNELS, SAMPLES
from zenostat.bridge.recording.chunk_writer import ChunkWriter
from zenostat.bridge.recording.file import open_recording
from zenostat.bridge.recording.reader import RecordedItem, RecordingReader
from zenostat.bridge.recording.recorder import Recorder, attachments
from zenostat.topics import codec, recording
from zenostat.topics.messages import Manifest


def unchanged(_: int, item: RecordedItem) -> bytes:
    """Leave a message as it is."""
    return item.payload


def rewrite(
    source: Path,
    target: Path,
    change: Callable[[int, RecordedItem], bytes | None] = unchanged,
    *,
    profile: str = recording.PROFILE,
    about: Mapping[str, str] | None = None,
    provenance: Mapping[str, Any] | None = None,
    manifest: Manifest | None = None,
) -> Path:
    """Copy a recording, with messages or descriptions changed.

    Args:
        source, target: paths.
        change: called with each message's number; returns its payload, or None to omit it.
        profile: of the file's header.
        about: replaces fields of the versions.
        provenance: replaces the provenance.
        manifest: replaces the manifest.
    """
    with RecordingReader(source) as reader, target.open("wb") as file:
        writer = ChunkWriter(file.fileno(), profile=profile, library="test")
        writer.add_metadata(recording.ABOUT, {**reader.versions, **(about or {})})
        attachments = dict(reader.attachments)
        if manifest is not None:
            attachments[recording.MANIFEST] = manifest.model_dump_json().encode()
        if provenance is not None:
            attachments[recording.PROVENANCE] = json.dumps(provenance).encode()
        for name, content in attachments.items():
            writer.add_attachment(name, "", content, 0)
        channels: dict[str, int] = {}
        for number, item in enumerate(reader.messages()):
            if item.topic not in channels:
                channels[item.topic] = len(channels)
                writer.add_channel(channels[item.topic], f"{reader.root}/{item.topic}", item.schema, b"{}")
            payload = change(number, item)
            if payload is not None:
                writer.add(channels[item.topic], item.time_ns, payload)
            if number % 50 == 49:
                writer.flush()
        writer.flush()
        writer.add_metadata(recording.SUMMARY, {"messages": str(writer.messages), "reason": ""})
        writer.finish()
        os.fsync(file.fileno())
    return target


def new_recorder(path: Path, *, descriptor: int | None = None, **settings: Any) -> Recorder:
    """Return a recorder for a node `office` without a plant of its own."""
    manifest = FakeEnv().manifest
    plant = PlantDescription(
        name="fake",
        run_period=RunPeriod(datetime(2017, 1, 1), 900.0, 96),
        sensors=manifest.sensors,
        meters=manifest.meters,
        actuators=manifest.actuators,
        versions=manifest.versions,
    )
    opened = open_recording(path) if descriptor is None else descriptor
    return Recorder(opened, path, "office", lambda: attachments(manifest, plant), **settings)


def record_samples(path: Path, samples: int, *, size: int = 400, **settings: Any) -> Path:
    """Record samples that are random bytes, numbered in their first four bytes, in several chunks."""
    rng = np.random.default_rng(0)
    recorder = new_recorder(path, **settings)
    for number in range(samples):
        recorder.add(SAMPLES, number.to_bytes(4, "little") + rng.bytes(size))
    recorder.close()
    return path


def records(path: Path) -> list[tuple[int, int, int]]:
    """Return the opcode of each record of a file, and where it begins and ends."""
    data, position, places = path.read_bytes(), 8, []
    while position < len(data) - 8:
        end = position + 9 + int.from_bytes(data[position + 1 : position + 9], "little")
        places.append((data[position], position, end))
        position = end
    return places


def chunk_ends(path: Path) -> list[int]:
    """Return the offsets at which the chunks of a file end."""
    return [end for opcode, _, end in records(path) if opcode == Opcode.CHUNK]


def damaged_heads(path: Path) -> Iterator[bytes]:
    """Iterate over the contents of a file with each bit of an opcode or a length changed.

    Of records of the same kind, the first, the second and the last are changed; the summary section is not.
    """
    data, kinds = path.read_bytes(), dict[int, list[int]]()
    for opcode, begin, _ in records(path):
        kinds.setdefault(opcode, []).append(begin)
        if opcode == Opcode.DATA_END:
            break
    for begins in kinds.values():
        for begin, bit in itertools.product({*begins[:2], begins[-1]}, range(72)):
            changed = bytearray(data)
            changed[begin + bit // 8] ^= 1 << bit % 8
            yield bytes(changed)


def cut(
    source: Path, target: Path, messages: int, change: Callable[[int, RecordedItem], bytes | None] = unchanged
) -> Path:
    """Write what a node that was killed after so many messages, not counting the audit chain's, would have recorded.

    `change` is as in `rewrite`, and omits nothing.
    """
    chain = AuditChain()
    with RecordingReader(source) as reader, target.open("wb") as file:
        writer = ChunkWriter(file.fileno(), profile=recording.PROFILE, library="test")
        writer.add_metadata(recording.ABOUT, reader.about)
        writer.add_attachment(recording.MANIFEST, "", reader.manifest.model_dump_json().encode(), 0)
        writer.add_attachment(recording.SCENARIO, "", reader.scenario.encode(), 0)
        writer.add_attachment(recording.PROVENANCE, "", json.dumps(reader.provenance).encode(), 0)
        channels: dict[str, int] = {}

        def add_channel(topic: str, kind: str) -> None:
            channels[topic] = len(channels)
            writer.add_channel(channels[topic], f"{reader.root}/{topic}", kind, b"{}")
            chain.add_channel(channels[topic], topic, kind)

        for topic, kind in CHANNELS:
            add_channel(topic, kind.__name__)
        selected = (item for item in reader.messages() if item.schema != "RecordedAudit")
        for number, item in enumerate(itertools.islice(selected, messages)):
            payload = change(number, item) or b""
            if item.topic not in channels:
                add_channel(item.topic, item.schema)
            writer.add(channels[item.topic], item.time_ns, payload)
            chain.add(channels[item.topic], item.time_ns, payload)
        if (record := chain.seal()) is not None:
            writer.add(AUDIT, item.time_ns, codec.encode(record))
        writer.flush()
    return target


def sample_numbers(path: Path) -> list[int]:
    """Return the numbers with which the samples of `record_samples` begin."""
    with RecordingReader(path) as reader:
        return [int.from_bytes(item.payload[:4], "little") for item in reader.messages({"Sample"})]
