"""Upgrade an IDF with EnergyPlus's own transition programs, where the user has them.

An installation of EnergyPlus has them in `PreProcess/IDFVersionUpdater`, one for each step, with the data dictionaries
that they need beside them. A program replaces the file that it is called with. They are in no wheel, so this module
is tested with a program that behaves alike.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from zenostat.models.input_format.encoding import decode_idf
from zenostat.models.input_format.idf_reader import idf_version
from zenostat.models.upgrade.versions import short
from zenostat.topics.errors import InvalidConfig, ModelError

_NAME = re.compile(r"Transition-V(\d+)-(\d+)-\d+-to-V(\d+)-(\d+)-\d+(\.exe)?")
_TIMEOUT_S = 600.0
_LINES = 5
"""Lines of a program's output that an error shows."""


@dataclass(frozen=True, slots=True)
class TransitionResult:
    """An IDF after the programs, and the versions that it passed through."""

    text: str
    versions: tuple[str, ...]


def find_programs(folder: Path) -> dict[str, tuple[str, Path]]:
    """Return the programs of a folder by the version that they upgrade: the version after, and the path.

    Raises:
        InvalidConfig: the folder has none.
    """
    programs = {}
    for path in sorted(folder.glob("Transition-V*")) if folder.is_dir() else ():
        if match := _NAME.fullmatch(path.name):
            programs[f"{match[1]}.{match[2]}"] = (f"{match[3]}.{match[4]}", path)
    if not programs:
        raise InvalidConfig(
            f"{folder} has no transition programs (Transition-V9-4-0-to-V9-5-0 and so on); an installation of "
            "EnergyPlus has them in PreProcess/IDFVersionUpdater"
        )
    return programs


def run_programs(source: Path, folder: Path, target: str) -> TransitionResult:
    """Upgrade an IDF step by step, as far as the programs of a folder go, but not beyond a version.

    Args:
        source: the IDF; it is not modified.
        folder: the programs.
        target: the version to end at.

    Raises:
        InvalidConfig: the file is no IDF with a version, or the folder has no program for its version.
        ModelError: a program failed, or did not write the next version.
    """
    programs = find_programs(folder)
    text = decode_idf(source.read_bytes())
    version = short(idf_version(text) or "")
    if source.suffix.lower() != ".idf" or not version:
        raise InvalidConfig(
            f"{source} is not an IDF with a version; EnergyPlus's transition programs read no other file"
        )
    if version != target and version not in programs:
        raise InvalidConfig(f"{source} is for EnergyPlus {version}; {folder} has programs for {', '.join(programs)}")
    versions = [version]
    with tempfile.TemporaryDirectory(prefix="transition-") as scratch:
        for path in folder.iterdir():
            (Path(scratch) / path.name).symlink_to(path.resolve())
        model = Path(scratch) / "model.idf"
        model.write_text(text, encoding="utf-8")
        while version != target and version in programs:
            version, program = programs[version]
            _run(Path(scratch) / program.name, model, version, source)
            versions.append(version)
        return TransitionResult(decode_idf(model.read_bytes()), tuple(versions))


def _run(program: Path, model: Path, after: str, source: Path) -> None:
    try:
        finished = subprocess.run(
            [program, model],
            cwd=program.parent,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
            timeout=_TIMEOUT_S,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ModelError(f"{program.name} could not upgrade {source}: {error}") from None
    written = short(idf_version(decode_idf(model.read_bytes())) or "")
    if finished.returncode or written != after:
        output = (finished.stdout + finished.stderr).decode(errors="replace").strip().splitlines()[-_LINES:]
        head = f"{program.name} could not upgrade {source}: it exited with code {finished.returncode}"
        version = f" and left version {written or 'none'}" if written != after else ""
        raise ModelError("\n  ".join([f"{head}{version}", *output]))
