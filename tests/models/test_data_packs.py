"""Data packs: fetched by pip, checked, unzipped whole or not at all; and found by name, there or not."""

import hashlib
import json
import multiprocessing
import os
import re
import signal
import stat
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
from support.data_packs import pack_of, sinergym, wheel

from zenostat.models import catalog
from zenostat.models import data_packs as store
from zenostat.models.catalog import find_building, find_weather
from zenostat.models.data_packs import PACKS, Pack, add, check_hash, folder, installed, remove, unzip
from zenostat.topics.cache import cached_dir, evict
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.scenario_ids import pack_ids

FILES = {
    "fake/data/buildings/hut.epJSON": "{}",
    "fake/data/weather/XX_Nowhere.123456_TMY3.epw": "LOCATION,Nowhere",
    "fake/__init__.py": "raise SystemExit('code of a pack was run')",
}


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A store of the test's own."""
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def mirror(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cache: Path) -> Path:
    """A folder that is all that pip knows."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "mirror"))
    return tmp_path / "mirror"


@pytest.fixture
def fake(mirror: Path, monkeypatch: pytest.MonkeyPatch) -> Pack:
    """A pack that pip finds there."""
    pack = pack_of(wheel(mirror, FILES))
    monkeypatch.setitem(PACKS, "fake", pack)
    return pack


def everything(path: Path) -> list[str]:
    """The files and empty folders below `path`."""
    return sorted(str(p.relative_to(path)) for p in path.rglob("*") if p.is_file() or not any(p.iterdir()))


# The real one


def test_data_packs__real_pack_is_what_is_promised_of_it():
    root = sinergym() / "sinergym"
    pack = PACKS["sinergym"]
    assert root == store.root("sinergym")
    assert {p.stem for p in (root / "data" / "buildings").glob("*.epJSON")} == set(pack.buildings)
    assert {p.stem for p in (root / "data" / "weather").glob("*.epw")} == set(pack.weathers)
    assert (len(pack.buildings), len(pack.weathers), pack.scenarios) == (9, 14, len(pack_ids()))
    licence = next((root.parent).glob("*.dist-info/licenses/LICENSE")).read_text()
    assert licence.startswith("MIT License")
    assert pack in installed()


def test_data_packs__each_building_and_weather_of_the_real_pack_is_found_by_its_name():
    sinergym()
    packed = [[e for e in listed() if e.pack == "sinergym"] for listed in (catalog.buildings, catalog.weathers)]
    assert [len(entries) for entries in packed] == [9, 14]
    for entries, find in zip(packed, (find_building, find_weather), strict=True):
        for entry in entries:
            assert entry.name == f"sinergym/{entry.plain}"
            for text in (entry.name, entry.name.upper().replace("SINERGYM", "sinergym"), f"sinergym/{entry.path.stem}"):
                assert find(text) == entry
    for entries in (catalog.buildings(), catalog.weathers()):
        assert len({entry.name for entry in entries}) == len(entries)
        assert [e.pack for e in entries] == sorted(e.pack for e in entries)
    assert all("Building" in json.loads(entry.path.read_bytes()) for entry in packed[0])


def test_data_packs__unprefixed_name_is_enough_where_the_wheel_has_nothing_like_it():
    sinergym()
    assert find_building("5ZoneAutoDXVAV").name == "sinergym/5ZoneAutoDXVAV"
    assert find_building("radiant").name == "sinergym/radiant_residential_building"
    assert find_weather("ESP_Granada").name == "sinergym/ESP_Granada"
    assert find_weather("granada").path.name == "ESP_Granada.084190_SWEC.epw"
    with pytest.raises(UnknownName, match=r"'2Zone' matches several: sinergym/2Zone\w+_CW, sinergym/2Zone\w+_DX"):
        find_building("2Zone")
    with pytest.raises(UnknownName, match=r"no building 'sinergym/5Zones'; did you mean 'sinergym/5ZoneAutoDXVAV'"):
        find_building("sinergym/5Zones")


@pytest.mark.parametrize(
    ("find", "text"),
    [
        (find_weather, "USA_IL_Chicago"),
        (find_weather, "USA_IL_Chicago-OHare.Intl.AP.725300_TMY3"),
        (find_weather, "724695"),
        (find_building, "office-medium"),
        (find_building, "ASHRAE901_OfficeMedium_STD2019_Denver"),
        (find_building, "sit-down"),
    ],
)
def test_data_packs__what_names_something_of_the_wheel_goes_on_naming_it(find, text, tmp_path, monkeypatch):
    sinergym()
    with_pack = find(text)
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path))
    assert find(text) == with_pack
    assert with_pack.pack == ""


@pytest.mark.parametrize("text", ["hotel", "qqq", "USA_CO", ""])
def test_data_packs__what_names_nothing_clear_without_the_pack_does_not_with_it(text, tmp_path, monkeypatch):
    sinergym()
    for _ in range(2):
        for find in (find_building, find_weather):
            with pytest.raises(UnknownName):
                find(text)
        monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path))


def test_data_packs__without_the_pack_its_names_state_what_to_do(cache):
    assert catalog.buildings() == catalog.bundled_buildings()
    assert catalog.weathers() == catalog.bundled_weathers()
    command = "is in the data pack 'sinergym': zenostat data-packs add sinergym"
    for text in ("5ZoneAutoDXVAV", "5zoneautodxvav", "5Zone", "sinergym/5ZoneAutoDXVAV", "sinergym/office"):
        with pytest.raises(UnknownName) as raised:
            find_building(text)
        assert str(raised.value) == f"building {text!r} {command}"
    for text in ("ESP_Granada", "ESP_Granada.084190_SWEC", "sinergym/USA_IL_Chicago", "SWEC"):
        with pytest.raises(UnknownName) as raised:
            find_weather(text)
        assert str(raised.value) == f"weather {text!r} {command}"
    with pytest.raises(UnknownName, match="no building 'sinergym/5Zones'; did you mean 'sinergym/5ZoneAutoDXVAV'"):
        find_building("sinergym/5Zones")
    with pytest.raises(InvalidConfig, match="needs the data pack 'sinergym': zenostat data-packs add sinergym"):
        folder("sinergym")
    assert installed() == []


# Adding


def test_data_packs__pack_is_fetched_once_and_nothing_of_it_is_run(fake, cache, mirror):
    messages: list[str] = []
    pack_folder = add("fake", messages.append)
    assert pack_folder == cache / "packs" / "fake-1.0" == folder("fake")
    assert messages == [
        "downloading zenostat-fake-pack==1.0 with pip",
        "unpacking zenostat_fake_pack-1.0-py3-none-any.whl",
    ]
    assert {name: (pack_folder / name).read_text() for name in FILES} == FILES
    assert [path.name for path in (cache / "packs").iterdir()] == ["fake-1.0"]
    (mirror / "zenostat_fake_pack-1.0-py3-none-any.whl").unlink()
    assert add("fake", messages.append) == pack_folder
    assert len(messages) == 2


@pytest.mark.slow
def test_data_packs__catalogue_follows_what_is_there(fake):
    assert not [e for e in catalog.buildings() if e.pack]
    add("fake")
    assert find_building("hut").name == "fake/hut"
    assert find_weather("fake/xx_nowhere").name == "fake/XX_Nowhere"
    assert [e.name for e in catalog.weathers() if e.pack] == ["fake/XX_Nowhere"]
    assert remove("fake")
    assert not [e for e in catalog.buildings() if e.pack]
    assert not remove("fake")
    add("fake")
    assert find_building("hut").path.is_file()


def test_data_packs__file_called_pip_in_the_users_folder_is_not_taken_for_pip(fake, tmp_path, monkeypatch):
    (tmp_path / "pip.py").write_text("raise SystemExit('a file of the user was run')")
    monkeypatch.chdir(tmp_path)
    assert add("fake").is_dir()


def test_data_packs__another_wheel_of_that_name_is_refused_by_pip(fake, cache, mirror):
    wheel(mirror, FILES | {"fake/more.txt": "more"})
    with pytest.raises(InvalidConfig, match=r"pip could not download zenostat-fake-pack==1\.0") as raised:
        add("fake")
    assert "THESE PACKAGES DO NOT MATCH THE HASHES" in str(raised.value)
    assert fake.sha256 in str(raised.value)
    assert everything(cache) == ["packs", "packs.lock"]


def test_data_packs__hash_is_checked_here_as_well(fake, tmp_path):
    other = wheel(tmp_path / "other", FILES | {"fake/more.txt": "more"})
    with pytest.raises(InvalidConfig, match=f"its sha256 is {hashlib.sha256(other.read_bytes()).hexdigest()}"):
        check_hash(other, fake)


def test_data_packs__what_pip_states_is_handed_on(mirror, monkeypatch, cache):
    mirror.mkdir()
    monkeypatch.setitem(PACKS, "fake", pack_of(wheel(mirror / "elsewhere", FILES)))
    with pytest.raises(InvalidConfig, match=r"No matching distribution found for zenostat-fake-pack==1\.0"):
        add("fake")
    assert everything(cache) == ["packs", "packs.lock"]


def test_data_packs__python_without_pip_states_how_to_get_it(fake, monkeypatch, tmp_path):
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "bare"], check=True)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "bare" / "bin" / "python"))
    with pytest.raises(InvalidConfig, match=r"has no pip to download .*; run \S*python -m ensurepip"):
        add("fake")


def test_data_packs__wheel_without_the_folder_that_is_used_is_refused(mirror, monkeypatch, cache):
    monkeypatch.setitem(PACKS, "fake", pack_of(wheel(mirror, {"other/a.txt": "a"})))
    with pytest.raises(InvalidConfig, match="contains no folder 'fake'"):
        add("fake")
    assert everything(cache) == ["packs", "packs.lock"]


def test_add__names_a_store_that_cannot_be_written(fake, cache):
    cache.write_text("a file")
    with pytest.raises(InvalidConfig, match=r"cannot write the cache .*ZENOSTAT_CACHE"):
        add("fake")


def test_data_packs__name_of_no_pack_lists_near_ones(cache):
    for do in (add, remove, folder):
        with pytest.raises(UnknownName, match="no data pack 'sinergim'; did you mean 'sinergym'"):
            do("sinergim")


# Unzipping


@pytest.mark.parametrize("name", ["../out.txt", "/tmp/out.txt", "a/../../out.txt", "a\\..\\out.txt"])
def test_data_packs__path_that_leaves_the_folder_is_refused(name, tmp_path):
    path = wheel(tmp_path / "w", {"fake/a.txt": "a", name: "out"})
    with pytest.raises(InvalidConfig, match="which is not a plain file inside it") as raised:
        unzip(path, tmp_path / "in" / "deep")
    assert repr(name) in str(raised.value)
    assert not list(tmp_path.rglob("out.txt"))
    assert not (tmp_path / "in").exists()


def test_data_packs__link_is_refused(tmp_path):
    path = tmp_path / "link.whl"
    with zipfile.ZipFile(path, "w") as archive:
        link = zipfile.ZipInfo("fake/link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(InvalidConfig, match="'fake/link', which is not a plain file"):
        unzip(path, tmp_path / "in")


def _zip(path: Path, *names: str, content: bytes = b"") -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.writestr(name or zipfile.ZipInfo(name), content)
    return path


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([""], "'', which is not a plain file"),
        (["./"], "not a plain file"),
        (["a", "a/b"], "'a' both as a file and as a folder"),
        (["a/b", "a"], "'a' both as a file and as a folder"),
        (["a/", "a"], "'a' both as a file and as a folder"),
        (["a/b/c", "a/b/c/d/e"], "'a/b/c' both as a file and as a folder"),
        (["d/" * 1500 + "f"], "more than 50 folders deep"),
        (["n" * 300], "not a plain file"),
        ([f"{n}" for n in range(10_001)], "10,001 files"),
    ],
)
def test_data_packs__odd_members_are_one_error_and_nothing_is_unpacked(tmp_path, names, words):
    path = _zip(tmp_path / "odd.whl", *names)
    with pytest.raises(InvalidConfig, match=rf"odd\.whl .*{words}") as caught:
        unzip(path, tmp_path / "in")
    assert len(str(caught.value)) < 300
    assert not (tmp_path / "in").exists()


def test_data_packs__file_that_is_repeated_is_refused(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = _zip(tmp_path / "odd.whl", "a", "a")
    with pytest.raises(InvalidConfig, match="contains 'a' twice"):
        unzip(path, tmp_path / "in")


def test_data_packs__encrypted_member_is_refused(tmp_path):
    raw = bytearray(_zip(tmp_path / "odd.whl", "a", content=b"secret").read_bytes())
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):  # local header, central directory: the flags
        raw[raw.index(mark) + at] |= 1
    (tmp_path / "odd.whl").write_bytes(raw)
    with pytest.raises(InvalidConfig, match="'a', which is encrypted"):
        unzip(tmp_path / "odd.whl", tmp_path / "in")


def test_data_packs__what_would_unpack_to_too_much_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "MAX_UNPACKED_BYTES", 1_000_000)
    path = _zip(tmp_path / "bomb.whl", "a", "b", content=bytes(600_000))
    assert path.stat().st_size < 10_000
    with pytest.raises(InvalidConfig, match=r"bomb\.whl would unpack to 2 files of 1 MB"):
        unzip(path, tmp_path / "in")
    assert not (tmp_path / "in").exists()


@pytest.mark.parametrize("at", [0, 30, 40])  # signature and name in the header, and contents
def test_data_packs__broken_member_is_one_error(tmp_path, at):
    path = _zip(tmp_path / "odd.whl", "a", content=bytes(range(256)) * 20)
    raw = bytearray(path.read_bytes())
    raw[at] ^= 0xFF
    path.write_bytes(raw)
    with pytest.raises(InvalidConfig, match=r"odd\.whl is not a wheel: "):
        unzip(path, tmp_path / "in")


def test_data_packs__what_is_no_zip_is_refused(tmp_path):
    path = tmp_path / "broken.whl"
    path.write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(InvalidConfig, match=r"broken\.whl is not a wheel"):
        unzip(path, tmp_path / "in")


# Several at once, and killed ones


def _add_at(barrier, pack: Pack) -> None:
    PACKS["fake"] = pack
    barrier.wait(60)
    messages: list[str] = []
    add("fake", messages.append)
    sys.stdout.write(f"said {len(messages)}\n")
    assert (folder("fake") / "fake/data/buildings/hut.epJSON").read_text() == "{}"


@pytest.mark.slow
def test_data_packs__processes_that_add_at_once_fetch_once(fake, cache, capfd):
    spawn = multiprocessing.get_context("spawn")
    barrier = spawn.Barrier(3)
    processes = [spawn.Process(target=_add_at, args=(barrier, fake)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(120)
    assert [process.exitcode for process in processes] == [0, 0, 0]
    assert sorted(capfd.readouterr().out.split("\n")) == ["", "said 0", "said 0", "said 2"]
    assert [path.name for path in (cache / "packs").iterdir()] == ["fake-1.0"]


def _stop_halfway(path: str) -> None:
    def make(target: Path) -> None:
        (target / "half.txt").write_text("half")
        Path(path).write_text("half")
        time.sleep(600)

    cached_dir("packs/fake-1.0", make)


def test_data_packs__killed_one_leaves_no_half_pack(fake, cache, tmp_path):
    process = multiprocessing.get_context("spawn").Process(target=_stop_halfway, args=(str(tmp_path / "mark"),))
    process.start()
    while not (tmp_path / "mark").exists():
        assert process.is_alive()
        process.join(0.01)
    assert installed() == []
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert installed() == []
    pack_folder = add("fake")
    assert not (pack_folder / "half.txt").exists()
    assert [path.name for path in (cache / "packs").iterdir()] == ["fake-1.0"]


def test_data_packs__folder_that_cannot_be_made_leaves_nothing(cache):
    def half(target: Path) -> None:
        (target / "half.txt").write_text("half")
        raise RuntimeError("the power went out")

    with pytest.raises(RuntimeError, match="the power went out"):
        cached_dir("packs/a", half)
    assert everything(cache) == ["packs", "packs.lock"]
    assert cached_dir("packs/a", lambda target: (target / "whole.txt").write_text("") and None).is_dir()
    assert evict("packs/a")
    assert not evict("packs/a")
    assert everything(cache) == ["packs", "packs.lock"]


# The command


def test_data_packs__command_lists_adds_and_removes(fake, cache, monkeypatch):
    from rich.console import Console
    from typer.testing import CliRunner

    from zenostat.cli.data_packs import app

    monkeypatch.setattr("zenostat.cli.data_packs.out", Console(width=300, highlight=False))
    runner = CliRunner()
    for arguments in ([], ["list"]):
        _, *rows = runner.invoke(app, arguments).stdout.splitlines()
        assert [re.split(" {2,}", row) for row in rows] == [
            ["sinergym", "3.12.2", "MIT", "not installed", "9 buildings, 14 weather files, 109 scenarios"],
            ["sinergym-paper", "3.6.2", "MIT", "not installed", "1 building, 1 weather file, 2 scenarios"],
            ["fake", "1.0", "MIT", "not installed", "1 building, 1 weather file, 0 scenarios"],
        ]
    assert "fake 1.0 installed" in runner.invoke(app, ["add", "fake"], catch_exceptions=False).stdout
    assert "is already installed" in runner.invoke(app, ["add", "fake"], catch_exceptions=False).stdout
    assert str(cache / "packs" / "fake-1.0") in runner.invoke(app).stdout
    assert runner.invoke(app, ["remove", "fake"]).stdout == "fake removed\n"
    assert runner.invoke(app, ["remove", "fake"]).stdout == "fake was not installed\n"
    assert isinstance(runner.invoke(app, ["add", "fak"]).exception, UnknownName)
