"""The versions that can be upgraded: their steps, and the input format of each."""

from __future__ import annotations

import gzip
import json
import re
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

from zenostat.models import energyplus
from zenostat.models.input_format.layout import Layout, engine_layout
from zenostat.models.upgrade import from_9, from_22
from zenostat.models.upgrade.step import VersionStep
from zenostat.topics.errors import InvalidConfig, MissingExtra
from zenostat.topics.extras import install_command

STEPS: tuple[VersionStep, ...] = (*from_9.STEPS, *from_22.STEPS)
"""All steps, in order."""

_VERSION = re.compile(r"\d+(\.\w+)*")

_SCHEMA_FOLDERS = {"9.0": "V9-0-1"}
"""Folders of idfkit's schemas that do not follow from the version's name."""


def short(version: object) -> str:
    """Shorten `25.2.0` to `25.2`; text that is not a version is unchanged."""
    match = re.match(r"\s*(\d+\.\d+)", str(version))
    return match[1] if match else str(version)


def steps_between(version: object, engine: str, name: str) -> tuple[VersionStep, ...]:
    """Return the steps from a file's version to the engine's; none if it is the same or unknown.

    Raises:
        InvalidConfig: there is no such sequence of steps; the text names the versions that have one.
    """
    target = short(engine)
    own = short(version) if version not in (None, "") else target
    if own == target:
        return ()
    if not _VERSION.fullmatch(str(version).strip()):
        raise InvalidConfig(
            f"{name}: Version is {str(version)!r}, which is no version of EnergyPlus, such as {target!r}"
        )
    begins, ends = [step.before for step in STEPS], [step.after for step in STEPS]
    if own not in begins or target not in ends[begins.index(own) :]:
        raise InvalidConfig(f"{name} is for EnergyPlus {version}; {advice(engine)}")
    return STEPS[begins.index(own) : ends.index(target) + 1]


def advice(engine: str) -> str:
    """Say which versions an engine can simulate, for the end of an error text."""
    return (
        f"the engine's version is {short(engine)}, and models for {STEPS[0].before} to {STEPS[-1].before} are "
        "upgraded; for earlier ones use EnergyPlus's transition programs (`zenostat models upgrade FILE "
        "--transition-programs FOLDER`), and for later ones another engine"
    )


def layout_of(version: str, *, name: str) -> Layout:
    """Return the input format of a version.

    Args:
        version: as in `25.1`.
        name: of the file that needs it, for the error.

    Raises:
        MissingExtra: it is not the engine's version, and idfkit is not installed.
    """
    if version == short(energyplus.version()):
        return engine_layout()
    if find_spec("idfkit") is None:
        raise MissingExtra(
            f"{name} is an IDF for EnergyPlus {version}, and reading it needs the input formats of earlier versions: "
            f"{install_command('models')}"
        )
    return Layout(schema_document(version), version)


@cache
def schema_document(version: str) -> dict[str, Any]:
    """Return the input schema of a version from idfkit; that package's own code is not imported."""
    folder = _SCHEMA_FOLDERS.get(version, f"V{version.replace('.', '-')}-0")
    path = files("idfkit") / "schemas" / folder / "Energy+.schema.epJSON.gz"
    return dict(json.loads(gzip.decompress(path.read_bytes())))
