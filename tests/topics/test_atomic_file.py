"""Atomic files: the new content replaces the old one as a whole, or not at all."""

from pathlib import Path

import pytest

from zenostat.topics.atomic_file import atomic_file


def test_atomic_file__file_is_replaced_on_success(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    path.write_text("old")
    with atomic_file(path) as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".zip")
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.zip"]
    assert path.read_text() == "new"


def test_atomic_file__error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    path.write_text("old")

    def write_half() -> None:
        with atomic_file(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError("the disk is full")

    with pytest.raises(RuntimeError, match="the disk is full"):
        write_half()
    assert [file.name for file in tmp_path.iterdir()] == ["a.zip"]
    assert path.read_text() == "old"
