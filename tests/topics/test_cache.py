"""Files made once under a key of content."""

import errno
import multiprocessing
import os
import pwd
import time
from collections.abc import Callable
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import NoReturn

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.topics import cache as cache_module
from zenostat.topics.cache import cached_bytes, cached_dir, digest
from zenostat.topics.errors import InvalidConfig


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


def text(content: str) -> Callable[[Path], None]:
    """A maker of a file with that content."""
    return lambda target: target.write_text(content) and None


def test_cache__file_is_made_once(cache: Path) -> None:
    assert cached_bytes("models/a.json", text("made")) == b"made"
    assert cached_bytes("models/a.json", never) == b"made"
    assert files(cache) == ["v2/models/a.json"]


def test_cache__maker_has_a_folder_of_its_own_on_the_same_disk_and_keeps_the_files_name(cache: Path) -> None:
    seen: list[Path] = []

    def make(target: Path) -> None:
        seen.append(target)
        (target.parent / "litter.txt").write_text("")
        (target.parent / "more").mkdir()
        target.write_text("made")

    cached_bytes("models/a.json", make)
    assert seen[0].name == "a.json"
    assert seen[0].parent != cache / "v2" / "models"
    assert seen[0].is_relative_to(cache)
    assert files(cache) == ["v2/models/a.json"]


def test_cache__what_a_killed_process_left_is_removed_a_day_later(cache: Path) -> None:
    old, new = (cache / "v2" / "models" / f".making-{name}" for name in ("old", "new"))
    for folder in (old, new):
        folder.mkdir(parents=True)
    os.utime(old, (time.time() - 86_401,) * 2)
    cached_bytes("models/a.json", text("whole"))
    assert files(cache) == ["v2/models/.making-new", "v2/models/a.json"]


def test_cache__maker_that_fails_leaves_nothing_behind(cache: Path) -> None:
    def half(target: Path) -> None:
        target.write_text("half")
        raise RuntimeError("the power went out")

    with pytest.raises(RuntimeError, match="the power went out"):
        cached_bytes("models/a.json", half)
    assert files(cache) == ["v2/models"]
    assert cached_bytes("models/a.json", text("whole")) == b"whole"


# Damage


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def _swap(path: Path) -> None:
    cached_bytes("models/b.json", text("of another"))
    path.with_name("b.json").replace(path)


def _folder_in_place(path: Path) -> None:
    path.unlink()
    (path / "within").mkdir(parents=True)


DAMAGES = {
    "truncated": _truncate,
    "empty": lambda path: path.write_bytes(b""),
    "one bit": lambda path: path.write_bytes(path.read_bytes()[:-1] + b"x"),
    "without a digest": lambda path: path.write_bytes(b"made"),
    "swapped": _swap,
    "a folder in place": _folder_in_place,
    "a link to nowhere in particular": lambda path: (path.unlink(), path.symlink_to(path)),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_cache__damaged_file_is_made_again_with_one_line_of_notice(
    cache: Path, damage: Callable[[Path], object], capsys: pytest.CaptureFixture[str]
) -> None:
    cached_bytes("models/a.json", text("made"))
    damage(cache / "v2" / "models" / "a.json")
    assert cached_bytes("models/a.json", text("made again")) == b"made again"
    (notice,) = capsys.readouterr().err.splitlines()
    assert f"the cached {cache}/v2/models/a.json is damaged" in notice
    assert cached_bytes("models/a.json", never) == b"made again"
    assert not capsys.readouterr().err


def test_cache__file_in_the_place_of_a_folder_gives_way(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cache.joinpath("packs").mkdir(parents=True)
    cache.joinpath("packs", "p").write_text("no folder")
    path = cached_dir("packs/p", lambda target: (target / "file").write_text("made") and None)
    assert (path / "file").read_text() == "made"
    assert "packs/p is damaged (it is not a folder)" in capsys.readouterr().err


# A cache that cannot be written


@pytest.mark.parametrize("make", [cached_bytes, cached_dir])
@pytest.mark.parametrize("place", ["/proc/nowhere", "file/below"])
def test_cache__cache_that_cannot_be_written_is_one_error_that_names_the_variable(
    make: Callable[..., object],
    place: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / place))
    with pytest.raises(InvalidConfig, match=r"cannot (read|write) the cache .*; set ZENOSTAT_CACHE to ") as caught:
        make("models/a.json", never)
    assert "\n" not in str(caught.value)
    assert not capsys.readouterr().err, "no notice of a damaged file beside the error"


def test_cache__full_disk_is_an_error_of_the_cache(cache: Path) -> None:
    def fill(_: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(InvalidConfig, match=r"No space left on device; .*ZENOSTAT_CACHE"):
        cached_bytes("models/a.json", fill)


def test_cache__error_of_another_file_stays_what_it_is(cache: Path) -> None:
    def look(_: Path) -> None:
        (cache / "not there").read_bytes()

    with pytest.raises(FileNotFoundError, match="not there"):
        cached_bytes("models/a.json", look)


def test_cache__without_a_home_folder_the_variable_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown_user(_: int) -> NoReturn:
        raise KeyError("no such user")

    for name in ("ZENOSTAT_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", unknown_user)
    with pytest.raises(InvalidConfig, match="ZENOSTAT_CACHE"):
        cache_module.cache_dir()


# Two at once


def _make_together(folder: str, barrier: Barrier, own: str) -> None:
    """Writes half of the file, waits for the other process to be as far, and writes the rest."""
    os.environ["ZENOSTAT_CACHE"] = folder

    def make(target: Path) -> None:
        with target.open("w") as file:
            file.write(own * 1000)
            file.flush()
            barrier.wait(60)
            assert not (Path(folder) / "v2" / "models" / "a.json").exists()
            barrier.wait(60)
            file.write(own * 1000)

    content = cached_bytes("models/a.json", make)
    assert content in (b"a" * 2000, b"b" * 2000), content[:20]


def test_cache__two_processes_that_make_the_same_file_at_once_do_not_disturb_each_other(cache: Path) -> None:
    spawn = multiprocessing.get_context("spawn")
    barrier = spawn.Barrier(2)
    both = [spawn.Process(target=_make_together, args=(str(cache), barrier, own)) for own in "ab"]
    for process in both:
        process.start()
    for process in both:
        process.join(120)
    assert [process.exitcode for process in both] == [0, 0]
    assert files(cache) == ["v2/models/a.json"]
    assert cached_bytes("models/a.json", never) in (b"a" * 2000, b"b" * 2000)


# Keys of content


def test_cache__key_is_24_hexadecimal_digits_of_the_content() -> None:
    key = digest("a", b"b")
    assert len(key) == 24
    assert set(key) <= set("0123456789abcdef")
    assert digest("a", b"b") == key
    assert digest("a", "c") != key


def test_cache__text_is_its_utf_8_bytes() -> None:
    assert digest("é") == digest("é".encode())


@given(st.lists(st.binary(max_size=3), max_size=4), st.lists(st.binary(max_size=3), max_size=4))
def test_cache__keys_are_equal_only_where_all_parts_are(one: list[bytes], other: list[bytes]) -> None:
    assert (digest(*one) == digest(*other)) == (one == other)


@given(st.binary(max_size=6), st.integers(0, 6), st.integers(0, 6))
def test_cache__where_the_parts_meet_matters(whole: bytes, cut: int, other: int) -> None:
    one, two = (whole[:cut], whole[cut:]), (whole[:other], whole[other:])
    assert (digest(*one) == digest(*two)) == (one == two)


# Where it is


def test_cache__store_is_where_the_environment_states(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_module.cache_dir() == tmp_path / "cache"
    monkeypatch.delenv("ZENOSTAT_CACHE")
    assert cache_module.cache_dir() == tmp_path / "xdg" / "zenostat"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_module.cache_dir() == tmp_path / "home" / ".cache" / "zenostat"
