"""Files of strangers: limits hold before anything is built, and each is one error."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from zenostat.agent_sdk.envs.arguments import check_agent_settings
from zenostat.agent_sdk.wrappers import restore_wrappers
from zenostat.bridge.alarms.rules import read_rules
from zenostat.bridge.faults import read_plan
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.models.scenario.schema import load_scenario, read_scenario
from zenostat.models.sinergym.scenarios import scenarios_of
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, UsageError


def _nested(first: str, level: str) -> str:
    """Nine levels, each of which repeats the one before nine times: 9**10 values."""
    levels = [f"a{n}: &a{n} {level % ','.join([f'*a{n - 1}'] * 9)}" for n in range(1, 10)]
    return "\n".join([f"a0: &a0 {first}", *levels])


HOSTILE = {
    "nested anchors": (_nested("[x]", "[%s]"), "more than 200000 values"),
    "merge bomb": (_nested("{x: 1}", "{<<: [%s]}"), "more than 200000 values"),
    "deep lists": ("a: " + "[" * 50_000 + "]" * 50_000, "more than 64 levels"),
    "deep blocks": ("\n".join(" " * n + "a:" for n in range(2_000)), "more than 64 levels"),
    "deep entries": ("a:\n" + "- " * 50_000 + "x", "more than 64 levels"),
    "no boolean": ("a: !!bool abc", "'abc' is neither true nor false"),
    "no number": ("a: !!int abc", "invalid literal"),
    "list as a mapping": ("a: !!map [1]", "tag .* is not supported"),
    "object of Python": ("a: !!python/object/apply:os.getcwd []", "tag .* is not supported"),
    "NUL in a value": ('building: "x\\0y"', "NUL character"),
    "NUL in a name": ('"x\\0y": 1', "NUL character"),
    "alias of itself": ("a: &a [*a]", "has no anchor before it"),
    "huge number": ("a: " + "1" * 100_000, "4300 digits"),
}


@pytest.mark.parametrize(("text", "words"), HOSTILE.values(), ids=HOSTILE)
def test_readable__hostile_text_is_one_short_error(text: str, words: str) -> None:
    with pytest.raises(InvalidConfig, match=words) as caught:
        yaml12.parse(text, "the file")
    assert len(str(caught.value)) < 500


def test_readable__anchors_merges_and_tags_within_the_limits_are_read() -> None:
    text = "a: &a {x: 1}\nb: {<<: *a, y: !!bool TRUE}\nc: [*a, *a]\nd: !!str 12"
    expected = {"a": {"x": 1}, "b": {"x": 1, "y": True}, "c": [{"x": 1}, {"x": 1}], "d": "12"}
    assert yaml12.parse(text, "the file") == expected


def test_readable__error_does_not_write_out_a_large_value() -> None:
    value: Any = ["x"]
    for _ in range(12):
        value = [value] * 9  # as shared lists: 9**12 values, if written out
    for form in (value, {"a": value}):
        with pytest.raises(InvalidConfig, match="building") as caught:
            read_scenario({"building": form, "weather": "w"})
        assert len(str(caught.value)) < 500


READERS: dict[str, Callable[[Path], object]] = {
    "scenario": load_scenario,
    "faults": read_plan,
    "alarms": read_rules,
    "configuration": scenarios_of,
    "wrappers": lambda path: restore_wrappers(None, path),
}


def _too_large(path: Path) -> None:
    path.write_bytes(b"#" * (yaml12.MAX_BYTES + 1))


PLACES: dict[str, Callable[[Path], object]] = {
    "FIFO": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "folder": Path.mkdir,
    "too large": _too_large,
    "not UTF-8": lambda path: path.write_bytes(b"\xff\xfe\xff"),
}


@pytest.mark.parametrize("make", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_readable__each_reader_refuses_what_is_no_text_file(
    read: Callable[[Path], object], make: Callable[[Path], object], tmp_path: Path
) -> None:
    path = tmp_path / "mine.yaml"
    make(path)
    with pytest.raises(UsageError, match=r"mine\.yaml"):
        read(path)
    assert check_agent_settings("scenario", {"scenario": str(path)}, Affinity.OFF) is None  # the node says why


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_readable__each_reader_has_the_limits(read: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(HOSTILE["nested anchors"][0])
    with pytest.raises(InvalidConfig, match=r"mine\.yaml.*more than 200000 values"):
        read(path)
