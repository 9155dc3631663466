"""The recorder: all messages in order, a full buffer, a full disk, and two recorders of one file."""

import itertools
import os
import resource
import shutil
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from mcap.reader import make_reader
from support.nodes import until
from support.recordings import chunk_ends, new_recorder, record_samples, sample_numbers

from zenostat.bridge.recording.channels import SAMPLES
from zenostat.bridge.recording.file import MAGIC, check_path, open_recording, recording_path
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, InvalidRecording
from zenostat.topics.messages import Command, OnFull, RecordingState


def test_recording__all_messages_are_there_in_order(tmp_path: Path) -> None:
    path = record_samples(tmp_path / "a.mcap", 6000)
    assert sample_numbers(path) == [*range(6000)]
    assert len(chunk_ends(path)) >= 2


def test_recording__without_messages_is_complete(tmp_path: Path) -> None:
    with RecordingReader(record_samples(tmp_path / "a.mcap", 0)) as reader:
        assert list(reader.messages()) == []
        assert (reader.end.is_complete, reader.end.is_damaged, reader.end.text) == (True, False, "")


def test_recording__file_is_what_other_readers_expect(tmp_path: Path) -> None:
    path = record_samples(tmp_path / "a.mcap", 6000)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        chunks = summary.statistics.chunk_count
        assert summary.statistics.message_count == 6000 + chunks  # each has a record of the chain
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) == len(chunk_ends(path))
        topic = keys.SAMPLE.at("office")
        numbers = [int.from_bytes(message.data[:4], "little") for _, _, message in reader.iter_messages(topic)]
        middle = summary.statistics.message_start_time + 1
        later = sum(1 for _ in reader.iter_messages(topic, starting_at=middle))
        assert {a.name for a in reader.iter_attachments()} == {"manifest.json", "scenario.yaml", "provenance.json"}
    assert numbers == [*range(6000)]
    assert 0 < later < 6000


def test_recording__is_written_while_the_clock_is_set_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour back after the first message: what is recorded is in the file long before the clock has caught up."""
    hour_ns, offsets_ns, count = 3600 * 10**9, [2 * 3600 * 10**9], itertools.count()
    monkeypatch.setattr("zenostat.bridge.recording.recorder.time_ns", lambda: offsets_ns[0] + next(count))
    path = tmp_path / "a.mcap"
    recorder = new_recorder(path)
    for number in range(3):
        recorder.add(SAMPLES, number.to_bytes(4, "little"))
        offsets_ns[0] = hour_ns
    until(lambda: recorder.status().messages, "a chunk is written")
    assert sample_numbers(path)[:1] == [0]
    recorder.close()
    assert sample_numbers(path) == [0, 1, 2]
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        statistics = reader.get_summary().statistics
        times_ns = [message.log_time for _, _, message in reader.iter_messages()]
    assert max(times_ns) - min(times_ns) > 0.9 * hour_ns
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times_ns), max(times_ns))


def test_recording__commands_with_an_encoding_of_their_own_have_a_channel_each_others_share_one(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "a.mcap")
    recorder.received(keys.COMMAND, "command/rbc", b"\x80", codec.encoding(Command))
    recorder.received(keys.COMMAND, "command/rbc", b"\x81", "text/plain")
    recorder.order(b"12345678", range(1))
    recorder.close()
    with RecordingReader(tmp_path / "a.mcap") as reader:
        items = list(reader.messages())
    assert [(i.topic, i.schema) for i in items] == [
        ("command/rbc", "Command"),
        ("others", "RecordedMessage"),
        ("orders", "RecordedOrder"),
        ("audit", "RecordedAudit"),
    ]
    assert items[0].payload == b"\x80"


class Pipe:
    """A disk that writes nothing until it is read: a pipe."""

    def __init__(self) -> None:
        self.read_end, self.write_end = os.pipe()
        self.content = b""

    def drain(self) -> None:
        """Read until the writer closes its end."""
        while part := os.read(self.read_end, 1 << 16):
            self.content += part
        os.close(self.read_end)


def test_recording__full_buffer_makes_the_node_wait_and_drops_nothing(tmp_path: Path) -> None:
    pipe = Pipe()
    recorder = new_recorder(tmp_path / "a.mcap", descriptor=pipe.write_end, buffer_bytes=100_000)
    payload = os.urandom(1000)

    def record() -> None:
        for number in range(1500):
            recorder.add(SAMPLES, number.to_bytes(4, "little") + payload)

    node = threading.Thread(target=record)
    node.start()
    until(lambda: recorder.status().waits, "the node waits")
    assert node.is_alive()
    reader = threading.Thread(target=pipe.drain)
    reader.start()
    node.join()
    recorder.close()
    reader.join()
    (tmp_path / "b.mcap").write_bytes(pipe.content)
    assert sample_numbers(tmp_path / "b.mcap") == [*range(1500)]
    with RecordingReader(tmp_path / "b.mcap") as opened:
        list(opened.messages())
        assert int(opened.end.metadata["waits"]) > 0
        assert opened.end.is_complete


def test_recording__node_that_ends_does_not_wait_for_the_disk(tmp_path: Path) -> None:
    pipe = Pipe()
    recorder = new_recorder(tmp_path / "a.mcap", descriptor=pipe.write_end, buffer_bytes=100_000)
    recorder.is_ending = lambda: True
    for _ in range(1500):  # returns although nothing is written
        recorder.add(SAMPLES, bytes(1000))
    reader = threading.Thread(target=pipe.drain)
    reader.start()
    recorder.close()
    reader.join()


def test_full_buffer__stops_the_recording_if_so_configured(tmp_path: Path) -> None:
    pipe, reasons = Pipe(), list[str]()
    recorder = new_recorder(
        tmp_path / "a.mcap",
        descriptor=pipe.write_end,
        buffer_bytes=100_000,
        on_full=OnFull.STOP,
        on_stopped=reasons.append,
    )
    payload = os.urandom(1000)
    for number in range(1500):
        recorder.add(SAMPLES, number.to_bytes(4, "little") + payload)
    reader = threading.Thread(target=pipe.drain)
    reader.start()
    recorder.close()
    reader.join()
    assert len(reasons) == 1
    assert "the disk is slower than the node" in reasons[0]
    assert recorder.status().state is RecordingState.STOPPED
    (tmp_path / "b.mcap").write_bytes(pipe.content)
    kept = sample_numbers(tmp_path / "b.mcap")
    assert 0 < len(kept) < 1500
    assert kept == [*range(len(kept))]  # without a gap
    with RecordingReader(tmp_path / "b.mcap") as opened:
        list(opened.messages())
        assert opened.end.text == reasons[0]


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size: what a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_recording__full_disk_stops_the_recording_by_name_and_leaves_whole_chunks(tmp_path: Path) -> None:
    reasons = list[str]()
    path = tmp_path / "a.mcap"
    with files_up_to(2_500_000):
        record_samples(path, 12_000, on_stopped=reasons.append)
    assert reasons == [f"cannot write {path}: File too large"]
    kept = sample_numbers(path)
    assert 0 < len(kept) < 12_000
    assert kept == [*range(len(kept))]
    assert chunk_ends(path)
    assert path.stat().st_size < 2_500_000  # what could not be written completely is cut off


def test_recording__one_file_has_one_recorder(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recorder = new_recorder(path)
    for function, overwrite in itertools.product((check_path, open_recording), (False, True)):
        with pytest.raises(InvalidConfig, match="another node is recording to"):
            function(path, overwrite=overwrite)
    recorder.close()
    with pytest.raises(InvalidConfig, match="exists; choose another name"):
        open_recording(path)
    with pytest.raises(InvalidConfig, match="exists; choose another name"):
        check_path(path)
    os.close(open_recording(path, overwrite=True))
    assert path.read_bytes() == b""


def test_recording__only_a_recording_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "thesis.mcap"
    check_path(path, overwrite=True)
    assert not path.exists()
    path.write_text("not a recording")
    for function in (check_path, open_recording):
        with pytest.raises(InvalidConfig, match="is not a recording"):
            function(path, overwrite=True)
    assert path.read_text() == "not a recording"
    path.write_bytes(MAGIC + b"anything")
    check_path(path, overwrite=True)
    assert path.read_bytes() == MAGIC + b"anything"
    os.close(open_recording(path, overwrite=True))


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "socket"])
def test_recording__only_a_regular_file_is_recorded_to_or_read_and_nothing_waits(
    tmp_path: Path, kind: str, *, overwrite: bool
) -> None:
    path = tmp_path / "a.mcap"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/null")
    else:
        with closing(socket.socket(socket.AF_UNIX)) as bound:
            bound.bind(str(path))
    for function in (check_path, open_recording):
        with pytest.raises(InvalidConfig, match=rf"a\.mcap is a {kind}; "):
            function(path, overwrite=overwrite)
    with pytest.raises(InvalidRecording, match=rf"^/\S*a\.mcap is a {kind}; "):
        RecordingReader(path)


def test_recording__removed_file_stops_the_recording_and_is_not_claimed(tmp_path: Path) -> None:
    reasons = list[str]()
    path = tmp_path / "runs" / "a.mcap"
    recorder = new_recorder(path, on_stopped=reasons.append)
    recorder.add(SAMPLES, bytes(1000))
    until(lambda: recorder.status().bytes > 1000, "a chunk is written")
    shutil.rmtree(path.parent)
    until(lambda: reasons, "the recorder notices it")
    recorder.close()
    assert reasons == [f"cannot write {path}: the file has been removed"]
    status = recorder.status()
    assert (status.state, status.messages, status.bytes) == (RecordingState.STOPPED, 0, 0)
    assert not path.parent.exists()


def test_recording__file_that_is_removed_just_before_the_end_is_not_claimed(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "a.mcap")
    recorder.add(SAMPLES, bytes(1000))
    (tmp_path / "a.mcap").unlink()
    recorder.close()
    status = recorder.status()
    assert (status.state, status.bytes) == (RecordingState.STOPPED, 0)
    assert "the file has been removed" in status.reason


@pytest.mark.parametrize("content", [b"", bytes(10), bytes(100_000)])
def test_recording__file_that_another_program_writes_stops_the_recording(tmp_path: Path, content: bytes) -> None:
    path, reasons = tmp_path / "a.mcap", list[str]()
    recorder = new_recorder(path, on_stopped=reasons.append)
    recorder.add(SAMPLES, bytes(1000))
    until(lambda: (written := recorder.status().bytes) > 1000 and path.stat().st_size == written, "a chunk is written")
    written = recorder.status().bytes
    path.write_bytes(content)
    recorder.add(SAMPLES, bytes(1000))
    recorder.close()
    (reason,) = reasons
    assert reason == (
        f"cannot write {path}: another program has changed the file: it has {len(content):,} of {written:,} bytes"
    )
    assert (recorder.status().state, recorder.status().bytes) == (RecordingState.STOPPED, 0)
    assert path.read_bytes() == content


@pytest.mark.parametrize("is_replaced", [False, True])
def test_recording__moved_file_is_complete_up_to_there(tmp_path: Path, *, is_replaced: bool) -> None:
    path, reasons = tmp_path / "a.mcap", list[str]()
    recorder = new_recorder(path, on_stopped=reasons.append)
    for number in range(5):
        recorder.add(SAMPLES, number.to_bytes(4, "little"))
    path.rename(tmp_path / "b.mcap")
    if is_replaced:
        path.touch()
    until(lambda: reasons, "the recorder notices it")
    recorder.add(SAMPLES, bytes(4))
    recorder.close()
    assert recorder.status().state is RecordingState.STOPPED
    assert sample_numbers(tmp_path / "b.mcap") == [*range(5)]
    with RecordingReader(tmp_path / "b.mcap") as opened:
        list(opened.messages())
        assert opened.end.is_complete
        assert opened.end.text == reasons[0] == f"{path} has been moved; the moved file ends there"


def test_recording__folder_gets_a_file_for_each_run(tmp_path: Path) -> None:
    first = recording_path(tmp_path / "runs", "office")
    assert first.parent == tmp_path / "runs"
    assert first.name.startswith("office-")
    first.parent.mkdir()
    first.touch()
    assert recording_path(tmp_path / "runs", "office") != first
    assert recording_path(tmp_path / "run.mcap", "office") == tmp_path / "run.mcap"
    with pytest.raises(InvalidConfig, match=r"suffix \.mcap"):
        recording_path(tmp_path / "run.rrd", "office")


def test_recording__folder_that_cannot_be_written_is_an_error_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidConfig, match="cannot record to"):
        open_recording(tmp_path / "file" / "a.mcap")
