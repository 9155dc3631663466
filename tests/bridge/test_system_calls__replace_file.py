"""A process that continues to read another file, as a fork does with the weather of its episode."""

from pathlib import Path

import pytest

from zenostat.bridge.engine.system_calls import replace_file


def test_system_calls__reading_continues_at_the_same_offset_of_the_other_file(folder: Path) -> None:
    first, second = folder / "first", folder / "second"
    first.write_bytes(b"common-one")
    second.write_bytes(b"common-two")
    with first.open("rb", buffering=0) as file:
        assert file.read(4) == b"comm"
        replace_file(str(first), str(second), limit=7)
        assert file.read() == b"on-two"


def test_system_calls__file_that_was_read_too_far_is_not_replaced(folder: Path) -> None:
    first, second = folder / "first", folder / "second"
    first.write_bytes(b"common-one")
    second.write_bytes(b"common-two")
    with first.open("rb", buffering=0) as file:
        file.read(8)
        with pytest.raises(RuntimeError, match="read up to byte 8, but may differ from byte 7 on"):
            replace_file(str(first), str(second), limit=7)
        assert file.read() == b"ne"


def test_system_calls__file_that_is_not_open_is_named(folder: Path) -> None:
    (folder / "first").touch()
    with pytest.raises(RuntimeError, match="first is not open"):
        replace_file(str(folder / "first"), str(folder / "first"), limit=0)
