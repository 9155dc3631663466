"""Files made once under a key of content."""

from __future__ import annotations

import multiprocessing
import os
from multiprocessing.synchronize import Barrier
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from models import store
from models.store import digest, made


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A store of the test's own."""
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def files(folder: Path) -> list[str]:
    """All that is in a folder, at any depth, but for folders that hold something."""
    return sorted(
        str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir() or not any(path.iterdir())
    )


def never(target: Path) -> None:
    raise AssertionError(f"{target} is there already")


def test_a_file_is_made_once(cache: Path) -> None:
    path = made("models/a.json", lambda target: target.write_text("made") and None)
    assert path == cache / "models" / "a.json"
    assert path.read_text() == "made"
    assert made("models/a.json", never) == path
    assert files(cache) == ["models/a.json"]


def test_a_maker_has_a_folder_of_its_own_on_the_same_disk_and_keeps_the_files_name(cache: Path) -> None:
    seen: list[Path] = []

    def make(target: Path) -> None:
        seen.append(target)
        (target.parent / "litter.txt").write_text("")
        (target.parent / "more").mkdir()
        target.write_text("made")

    path = made("models/a.json", make)
    assert seen[0].name == path.name
    assert seen[0].parent != path.parent
    assert seen[0].is_relative_to(cache)
    assert files(cache) == ["models/a.json"]


def test_a_maker_that_fails_leaves_nothing_behind(cache: Path) -> None:
    def half(target: Path) -> None:
        target.write_text("half")
        raise RuntimeError("the power went out")

    with pytest.raises(RuntimeError, match="the power went out"):
        made("models/a.json", half)
    assert files(cache) in ([], ["models"])
    assert made("models/a.json", lambda target: target.write_text("whole") and None).read_text() == "whole"


def test_a_maker_that_makes_nothing_is_an_error(cache: Path) -> None:
    with pytest.raises(FileNotFoundError):
        made("a.json", lambda target: None)
    assert files(cache) == []


def _make_together(folder: str, barrier: Barrier, own: str) -> None:
    """Writes half of the file, waits for the other process to be as far, and writes the rest."""
    os.environ["ZENOSTAT_CACHE"] = folder

    def make(target: Path) -> None:
        with target.open("w") as file:
            file.write(own * 1000)
            file.flush()
            barrier.wait(60)
            assert not (Path(folder) / "models" / "a.json").exists()
            barrier.wait(60)
            file.write(own * 1000)

    path = made("models/a.json", make)
    content = path.read_text()
    assert content in ("a" * 2000, "b" * 2000), content[:20]


def test_two_processes_that_make_the_same_file_at_once_do_not_disturb_each_other(cache: Path) -> None:
    spawn = multiprocessing.get_context("spawn")
    barrier = spawn.Barrier(2)
    both = [spawn.Process(target=_make_together, args=(str(cache), barrier, own)) for own in "ab"]
    for process in both:
        process.start()
    for process in both:
        process.join(120)
    assert [process.exitcode for process in both] == [0, 0]
    assert files(cache) == ["models/a.json"]
    assert made("models/a.json", never).read_text() in ("a" * 2000, "b" * 2000)


# Keys of content


def test_a_key_is_24_hexadecimal_digits_of_the_content() -> None:
    key = digest("a", b"b")
    assert len(key) == 24
    assert set(key) <= set("0123456789abcdef")
    assert digest("a", b"b") == key
    assert digest("a", "c") != key


def test_text_is_its_utf_8_bytes() -> None:
    assert digest("é") == digest("é".encode())


@given(st.lists(st.binary(max_size=3), max_size=4), st.lists(st.binary(max_size=3), max_size=4))
def test_keys_are_equal_only_where_all_parts_are(one: list[bytes], other: list[bytes]) -> None:
    assert (digest(*one) == digest(*other)) == (one == other)


@given(st.binary(max_size=6), st.integers(0, 6), st.integers(0, 6))
def test_where_the_parts_meet_matters(whole: bytes, cut: int, other: int) -> None:
    one, two = (whole[:cut], whole[cut:]), (whole[:other], whole[other:])
    assert (digest(*one) == digest(*two)) == (one == two)


# Where it is


def test_the_store_is_where_the_environment_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert store.store() == tmp_path / "cache"
    monkeypatch.delenv("ZENOSTAT_CACHE")
    assert store.store() == tmp_path / "xdg" / "zenostat"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert store.store() == tmp_path / "home" / ".cache" / "zenostat"
