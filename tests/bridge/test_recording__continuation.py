"""A recorder goes on with a file that ended anywhere: what was complete stays, and the whole is one recording."""

import io
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from support.recordings import chunk_ends, damaged_heads, new_recorder, record_samples, sample_numbers

from zenostat.bridge.recording.audit_chain import check_audit
from zenostat.bridge.recording.channels import EVENTS, SAMPLES
from zenostat.bridge.recording.continuation import has_messages, read_written
from zenostat.bridge.recording.file import MAGIC, open_recording, open_written
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.recording.records import MAX_DROPPED
from zenostat.topics import codec
from zenostat.topics.errors import InvalidRecording
from zenostat.topics.keys import COMMAND
from zenostat.topics.messages import Command, Event, EventKind

COMMAND_ENCODING = codec.encoding(Command)


def payload(number: int) -> bytes:
    """Random bytes after a number, so that chunks do not shrink."""
    return number.to_bytes(4, "little") + np.random.default_rng(number).bytes(40_000)


def record(path: Path, numbers: range, *, goes_on: bool = False) -> None:
    """Record samples with events and commands between them, to a new file or to one that ended."""
    written = read_written(path) if goes_on else None
    descriptor = open_written(path) if goes_on else open_recording(path)
    recorder = new_recorder(path, descriptor=descriptor, written=written)
    for number in numbers:
        recorder.add(SAMPLES, payload(number))
        recorder.record(EVENTS, Event(kind=EventKind.WARNING, text=f"{number}"))
        recorder.received(COMMAND, COMMAND.below(sender=f"sender-{number % 3}"), b"\x80", COMMAND_ENCODING)
    recorder.close()
    assert not recorder.status().reason


@pytest.fixture(scope="module")
def complete(module_scratch: Path) -> Path:
    path = module_scratch / "complete.mcap"
    record(path, range(60))
    return path


@pytest.mark.parametrize("seed", range(12))
def test_recorder__goes_on_with_a_file_that_ended_anywhere(seed: int, complete: Path, scratch: Path) -> None:
    data, path = complete.read_bytes(), scratch / "cut.mcap"
    ends = chunk_ends(complete)
    assert len(ends) >= 2
    size = int(np.random.default_rng(seed).integers(ends[0], len(data) + 1)) if seed else len(data)
    path.write_bytes(data[:size] + (b"\0" * 3000 if seed % 2 else b""))
    kept = sum(end <= size for end in ends)
    before = sample_numbers(path)
    with RecordingReader(path) as reader:
        entries = sum(item.schema in ("Event", "Command") for item in reader.messages())
    record(path, range(60, 70), goes_on=True)
    assert path.read_bytes()[: ends[kept - 1]] == data[: ends[kept - 1]]  # nothing before has changed
    assert sample_numbers(path) == [*before, *range(60, 70)]
    with RecordingReader(path) as reader:
        audit, end = check_audit(reader), reader.end
        topics = {item.topic for item in reader.messages()}
    assert (end.is_complete, end.text, audit.problems) == (True, "", [])
    assert audit.entries == entries + 2 * 10
    assert {f"command/sender-{number}" for number in range(3)} <= topics
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        messages = list(make_reader(file).iter_messages(topics=["zenostat/v3/office/sample"]))
    assert summary.statistics.message_count == sum(summary.statistics.channel_message_counts.values())
    assert [int.from_bytes(message.data[:4], "little") for _, _, message in messages] == [*before, *range(60, 70)]
    assert list(StreamReader(io.BytesIO(path.read_bytes()), validate_crcs=True).records)


def test_recording__first_chunk_decides_whether_there_is_anything_to_go_on_with(complete: Path, scratch: Path) -> None:
    path, first = scratch / "head.mcap", chunk_ends(complete)[0]
    assert has_messages(complete)
    assert not has_messages(path)
    for size in (0, len(MAGIC), 200, 1000):
        path.write_bytes(complete.read_bytes()[:size])
        assert not has_messages(path)
    path.write_bytes(complete.read_bytes()[:first])
    assert has_messages(path)
    path.write_bytes(b"mine, and no recording")
    with pytest.raises(InvalidRecording, match="is not an MCAP file"):
        has_messages(path)


def test_recording__more_than_a_chunk_after_damage_is_not_dropped(complete: Path, scratch: Path) -> None:
    data, path = complete.read_bytes(), scratch / "damaged.mcap"
    begin = chunk_ends(complete)[0]
    path.write_bytes(data[:begin] + b"\0" * (MAX_DROPPED + 1))
    with pytest.raises(InvalidRecording, match=r"damaged after byte [\d,]+, and [\d,]+ bytes follow"):
        read_written(path)


@pytest.mark.parametrize("hole", [1, 50])
def test_recording__data_behind_damage_is_not_overwritten(scratch: Path, hole: int) -> None:
    path = scratch / "damaged.mcap"
    record(path, range(120))
    data, (first, second, third, *_) = bytearray(path.read_bytes()), chunk_ends(path)
    place = (first + second) // 2
    data[place : place + hole] = bytes(255 - value for value in data[place : place + hole])
    for end in (third, len(data)):  # of a killed node, and of one that was stopped
        path.write_bytes(data[:end])
        with pytest.raises(InvalidRecording, match=r"damaged at byte [\d,]+, and complete data follow.*truncate -s"):
            read_written(path)
    path.write_bytes(data[:second])  # nothing is behind it
    written = read_written(path)
    assert first <= written.offset < second
    assert written.dropped == second - written.offset


def test_recording__damage_in_the_last_chunk_of_a_complete_file_is_told(complete: Path, scratch: Path) -> None:
    data, path = bytearray(complete.read_bytes()), scratch / "damaged.mcap"
    *_, before, last = chunk_ends(complete)
    data[(before + last) // 2] ^= 255
    path.write_bytes(data)
    with pytest.raises(InvalidRecording, match="complete data follow"):
        read_written(path)


@pytest.mark.parametrize("chunks", [1, 2, None])
def test_recording__another_recording_behind_its_end_is_not_overwritten(
    complete: Path, scratch: Path, chunks: int | None
) -> None:
    data, path = complete.read_bytes(), scratch / "both.mcap"
    for first in (data, data[:-100]):  # also of a node that was killed while it completed the file
        path.write_bytes(first + (data if chunks is None else data[: chunk_ends(complete)[chunks - 1]]))
        with pytest.raises(InvalidRecording, match=r"(ends|damaged) at byte [\d,]+, and complete data follow"):
            read_written(path)


def test_recording__what_is_behind_its_end_and_no_recording_is_dropped_and_counted(
    complete: Path, scratch: Path
) -> None:
    data, path = complete.read_bytes(), scratch / "longer.mcap"
    path.write_bytes(data + b"hello\n")
    assert read_written(path).dropped == 6
    path.write_bytes(data + bytes(MAX_DROPPED + 1))
    with pytest.raises(InvalidRecording, match=rf"ends after byte {len(data):,}, and [\d,]+ bytes follow"):
        read_written(path)


def test_recording__damaged_summary_is_written_again(complete: Path, scratch: Path) -> None:
    data, path = bytearray(complete.read_bytes()), scratch / "damaged.mcap"
    data[-100] ^= 1
    path.write_bytes(data)
    record(path, range(60, 62), goes_on=True)
    with RecordingReader(path) as reader:
        assert list(reader.messages())
    assert (reader.end.is_complete, reader.end.text) == (True, "")
    assert sample_numbers(path) == [*range(62)]


def test_recording__damaged_opcode_or_length_is_never_overwritten(scratch: Path) -> None:
    whole, path = record_samples(scratch / "whole.mcap", 2600), scratch / "damaged.mcap"
    samples = len(sample_numbers(whole))
    for content in damaged_heads(whole):
        path.write_bytes(content)
        with suppress(InvalidRecording):
            assert has_messages(path)
        with suppress(InvalidRecording), RecordingReader(path):
            written = read_written(path)
            assert written.counts[SAMPLES] == samples
