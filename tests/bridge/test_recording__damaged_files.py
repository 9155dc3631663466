"""Files that end early, are damaged, foreign or newer: what is complete is read, and the reason is one sentence."""

import io
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import Writer
from support.recordings import chunk_ends, damaged_heads, record_samples, records, rewrite

from zenostat.bridge.recording.reader import RecordedItem, RecordingReader
from zenostat.topics.errors import InvalidRecording
from zenostat.topics.recording import SUMMARY

SAMPLES = 700


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in several chunks of 50 samples."""
    folder = tmp_path_factory.mktemp("recordings")

    def samples(_: int, item: RecordedItem) -> bytes | None:
        return item.payload if item.schema == "Sample" else None

    return rewrite(record_samples(folder / "source.mcap", SAMPLES), folder / "whole.mcap", samples)


def read(path: Path) -> tuple[list[int], RecordingReader]:
    with RecordingReader(path) as reader:
        return [int.from_bytes(item.payload[:4], "little") for item in reader.messages()], reader


def test_recording__whole_file_is_read(whole: Path) -> None:
    steps, reader = read(whole)
    assert steps == [*range(SAMPLES)]
    assert (reader.end.is_complete, reader.end.text) == (True, "")


def test_recording__file_cut_at_any_chunk_is_read_up_to_there(whole: Path, tmp_path: Path) -> None:
    data, ends = whole.read_bytes(), chunk_ends(whole)
    assert len(ends) == SAMPLES // 50
    for chunks, end in enumerate(ends, 1):
        for offset, expected in ((end - 1, 50 * (chunks - 1)), (end, 50 * chunks), (end + 5, 50 * chunks)):
            (tmp_path / "cut.mcap").write_bytes(data[:offset])
            steps, reader = read(tmp_path / "cut.mcap")
            assert steps == [*range(expected)]
            assert not reader.end.is_complete
            assert "it was cut off after byte" in reader.end.text


@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_recording__changed_byte_is_never_read_as_a_message(whole: Path, place: float, bit: int) -> None:
    data = bytearray(whole.read_bytes())
    data[int(place * len(data))] ^= 1 << bit
    path = whole.with_name("changed.mcap")
    path.write_bytes(data)
    with suppress(InvalidRecording):
        steps, reader = read(path)
        assert steps == [*range(len(steps))]  # a prefix, each as it was
        assert reader.end.text
        assert len(steps) == SAMPLES or not reader.end.is_complete


def test_recording__damaged_summary_or_index_is_named_and_all_messages_are_read(whole: Path, tmp_path: Path) -> None:
    parts = {"summary": Opcode.STATISTICS, "data section": Opcode.MESSAGE_INDEX}
    for part, opcode in parts.items():
        data = bytearray(whole.read_bytes())
        data[next(end for kind, _, end in records(whole) if kind == opcode) - 2] ^= 1
        (tmp_path / "damaged.mcap").write_bytes(data)
        steps, reader = read(tmp_path / "damaged.mcap")
        assert steps == [*range(SAMPLES)]
        assert (reader.end.is_complete, reader.end.is_damaged) == (True, True)
        assert reader.end.text == f"the checksum of its {part} does not match, but all messages are intact"


def test_recording__file_of_an_earlier_release_has_no_checksum_of_its_data(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    end = next(end for opcode, _, end in records(whole) if opcode == Opcode.DATA_END)
    assert any(data[end - 4 : end])
    data[end - 4 : end] = bytes(4)
    (tmp_path / "earlier.mcap").write_bytes(data)
    steps, reader = read(tmp_path / "earlier.mcap")
    assert steps == [*range(SAMPLES)]
    assert (reader.end.is_complete, reader.end.text) == (True, "")


@pytest.mark.parametrize("kind", ["bytes", "another recording", "the beginning of another recording"])
def test_recording__what_follows_its_end_is_named(whole: Path, tmp_path: Path, kind: str) -> None:
    data = whole.read_bytes()
    more = {"bytes": b"hello\n", "another recording": data}.get(kind, data[: chunk_ends(whole)[1]])
    (tmp_path / "longer.mcap").write_bytes(data + more)
    steps, reader = read(tmp_path / "longer.mcap")
    assert steps == [*range(SAMPLES)]
    assert (reader.end.is_complete, reader.end.is_damaged) == (True, True)
    assert reader.end.text == f"{len(more):,} bytes after its end at byte {len(data):,}, not part of it"


def test_recording__damaged_chunk_is_named_and_what_is_before_it_is_read(whole: Path, tmp_path: Path) -> None:
    data, ends = bytearray(whole.read_bytes()), chunk_ends(whole)
    data[ends[2] - 30] ^= 1
    (tmp_path / "damaged.mcap").write_bytes(data)
    steps, reader = read(tmp_path / "damaged.mcap")
    assert steps == [*range(100)]
    assert reader.end.is_damaged
    assert "it is damaged at byte" in reader.end.text


def test_recording__damaged_opcode_or_length_never_hides_messages(whole: Path, tmp_path: Path) -> None:
    for content in damaged_heads(whole):
        (tmp_path / "damaged.mcap").write_bytes(content)
        with suppress(InvalidRecording):
            steps, reader = read(tmp_path / "damaged.mcap")
            assert reader.end.is_damaged or (reader.end.is_complete and steps == [*range(SAMPLES)])


def test_recording__damaged_length_before_the_first_message_is_named(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    begin = next(begin for opcode, begin, _ in records(whole) if opcode == Opcode.ATTACHMENT)
    data[begin + 6] ^= 1
    (tmp_path / "damaged.mcap").write_bytes(data)
    with pytest.raises(InvalidRecording, match=rf"is damaged at byte {begin:,}, before its first message"):
        RecordingReader(tmp_path / "damaged.mcap")


def test_recording__damaged_length_is_not_described_as_the_end_of_a_killed_node(whole: Path, tmp_path: Path) -> None:
    data, begin = bytearray(whole.read_bytes()), chunk_ends(whole)[1]
    data[begin + 6] ^= 1  # in the length of the message index
    for end in (len(data), chunk_ends(whole)[4]):  # of a completed file, and of a killed node's
        (tmp_path / "damaged.mcap").write_bytes(data[:end])
        steps, reader = read(tmp_path / "damaged.mcap")
        assert steps == [*range(100)]
        assert reader.end.is_damaged
        assert f"it is damaged at byte {begin:,}, and {end - begin:,} bytes follow" in reader.end.text


def test_recording__missing_chunk_is_a_gap(whole: Path, tmp_path: Path) -> None:
    data, ends = whole.read_bytes(), chunk_ends(whole)
    (tmp_path / "gap.mcap").write_bytes(data[: ends[2]] + data[ends[3] :])
    steps, reader = read(tmp_path / "gap.mcap")
    assert steps == [*range(150)]
    assert reader.end.is_damaged
    assert "messages are missing" in reader.end.text


def test_recording__last_chunk_that_is_not_recognized_is_a_gap(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    data[[begin for opcode, begin, _ in records(whole) if opcode == Opcode.CHUNK][-1]] = Opcode.MESSAGE_INDEX
    (tmp_path / "gap.mcap").write_bytes(data)
    steps, reader = read(tmp_path / "gap.mcap")
    assert steps == [*range(SAMPLES - 50)]
    assert reader.end.is_damaged
    assert "messages are missing" in reader.end.text


def test_recording__summary_that_cannot_be_read_is_named(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    place = data.index(SUMMARY.encode())
    for at, byte in ((place - 1, 0xFF), (place, 0x85), (place + len(SUMMARY), 0xFF)):  # lengths, and no UTF-8
        changed = data.copy()
        changed[at] = byte
        (tmp_path / "damaged.mcap").write_bytes(changed)
        steps, reader = read(tmp_path / "damaged.mcap")
        assert steps == [*range(SAMPLES)]
        assert reader.end.is_damaged
        assert "its summary cannot be read" in reader.end.text


def foreign() -> bytes:
    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="ros2", library="somebody")
    writer.finish()
    return file.getvalue()


BAD = {
    "no file": (None, "No such file"),
    "an empty file": (b"", "is empty"),
    "another format": (b"PK\x03\x04 something", "is not an MCAP file"),
    "of another program": (foreign(), "is an MCAP file of somebody, not a recording of Zenostat"),
}


@pytest.mark.parametrize("case", BAD)
def test_recording__what_is_no_recording_is_one_sentence(case: str, tmp_path: Path) -> None:
    content, expected = BAD[case]
    path = tmp_path / "file.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InvalidRecording, match=expected) as caught:
        RecordingReader(path)
    assert "\n" not in str(caught.value)


def test_recording__file_that_ends_before_its_first_message_has_nothing(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "begun.mcap").write_bytes(whole.read_bytes()[:200])
    with pytest.raises(InvalidRecording, match="ends before its first message"):
        RecordingReader(tmp_path / "begun.mcap")


@pytest.mark.parametrize("field", ["format", "schema_version"])
def test_recording__newer_file_names_the_release_that_wrote_it(whole: Path, tmp_path: Path, field: str) -> None:
    path = rewrite(whole, tmp_path / "newer.mcap", about={field: "99", "zenostat": "7.1"})
    with pytest.raises(InvalidRecording, match=rf"was recorded by Zenostat 7\.1 with {field.replace('_', ' ')} 99"):
        RecordingReader(path)
