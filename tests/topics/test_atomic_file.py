"""Atomic files: the new content replaces the old one as a whole, or not at all."""

from pathlib import Path

import pytest

from zenostat.topics.atomic_file import atomic_file, check_writable
from zenostat.topics.errors import InvalidConfig


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


def test_atomic_file__error_of_a_write_names_the_file(tmp_path: Path) -> None:
    def write(path: Path, target: Path) -> None:
        with atomic_file(path), target.open("wb", buffering=0) as file:
            file.write(b"x")

    with pytest.raises(OSError, match="No space left on device") as full:
        write(tmp_path / "a.csv", Path("/dev/full"))
    assert full.value.filename == str(tmp_path / "a.csv")
    with pytest.raises(FileNotFoundError) as other:
        write(tmp_path / "a.csv", tmp_path / "nowhere" / "b")
    assert other.value.filename == str(tmp_path / "nowhere" / "b")


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("nowhere/a.csv", "x: there is no folder"),
        ("folder", "x: expected a file, but this is a folder"),
        ("a" * 250 + ".csv", "x: no file can be written in .*: File name too long"),
        ("/proc/a.csv", "x: no file can be written in /proc: "),
    ],
)
def test_check_writable__states_why_not(path: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(InvalidConfig, match=text):
        check_writable(tmp_path / path, "x")
    check_writable(tmp_path / "a.csv", "x")
    assert [file.name for file in tmp_path.iterdir()] == ["folder"]
