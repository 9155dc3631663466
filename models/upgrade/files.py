"""Model files: read one of any known version and upgrade it, and write one."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from zenostat.models import energyplus
from zenostat.models.catalog import MODEL_SUFFIXES
from zenostat.models.input_format.encoding import check_encoding, decode_epjson, decode_idf
from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.models.input_format.source_model import ObjectsOfType
from zenostat.models.upgrade.programs import run_programs
from zenostat.models.upgrade.step import Change
from zenostat.models.upgrade.upgrade import UpgradedModel, upgrade_epjson, upgrade_idf
from zenostat.models.upgrade.versions import short
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.user_file import check_user_file, user_file


def upgrade_file(path: Path, programs: Path | None = None) -> UpgradedModel:
    """Read an IDF or an epJSON and upgrade it to the engine's version.

    Args:
        path: of the file.
        programs: folder of EnergyPlus's transition programs; they upgrade an IDF as far as they go, and the rules the
            rest.

    Raises:
        UnknownName: there is no such file.
        InvalidConfig: it is not a model, or it cannot be upgraded.
        ModelError: a transition program failed.
    """
    check_user_file(path, UnknownName, "a model file")
    if path.suffix.lower() not in MODEL_SUFFIXES:
        raise InvalidConfig(f"{path.name} is not a model file: its suffix should be {' or '.join(MODEL_SUFFIXES)}")
    with user_file(path):
        raw = path.read_bytes()
    is_idf = path.suffix.lower() == ".idf"
    if is_idf:
        check_encoding(raw, path)
    if programs is not None:
        return _with_programs(path, programs)
    if is_idf:
        return upgrade_idf(decode_idf(raw), name=path.name)
    text = decode_epjson(raw, path)
    try:
        objects: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidConfig(f"{path} is not an epJSON file: {error}") from None
    if not isinstance(objects, dict):
        raise InvalidConfig(f"{path} is not an epJSON file: it is not an object")
    return upgrade_epjson(objects, name=path.name, text=text)


def cached_upgrade(text: str, *, name: str) -> UpgradedModel:
    """Return `upgrade_idf` of a text, computed once for each content, engine version and state of the rules."""

    def make(target: Path) -> None:
        target.write_text(json.dumps(asdict(upgrade_idf(text, name=name))))

    key = digest(text, energyplus.version(), _rules())
    stored = json.loads(cached_bytes(f"models/{key}-upgraded.json", make))
    changes = tuple(Change(**change) for change in stored["changes"])
    return UpgradedModel(stored["objects"], stored["before"], stored["after"], changes)


@cache
def _rules() -> str:
    """Return a digest of the code that reads and upgrades models."""
    folder = Path(__file__).parent
    sources = sorted([*folder.glob("*.py"), *folder.with_name("input_format").glob("*.py")])
    return digest(*(path.read_bytes() for path in sources))


def _with_programs(path: Path, programs: Path) -> UpgradedModel:
    result = run_programs(path, programs, short(energyplus.version()))
    upgraded = upgrade_idf(result.text, name=path.name)
    pairs = pairwise(result.versions)
    own = [Change(before, after, "Version", path.name, "upgraded by EnergyPlus's program") for before, after in pairs]
    return replace(upgraded, before=result.versions[0], changes=(*own, *upgraded.changes))


def write_model(objects: dict[str, ObjectsOfType], path: Path) -> None:
    """Write a model of the engine's version as an IDF or an epJSON, by the suffix; a present file is replaced.

    Raises:
        InvalidConfig: an IDF cannot have one of the model's texts, or the file cannot be written.
    """
    is_idf = path.suffix.lower() == ".idf"
    text = write_idf(objects, engine_layout()) if is_idf else json.dumps(objects, indent=2) + "\n"
    try:
        with atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InvalidConfig(f"cannot write {path.absolute()}: {error.strerror or error}") from None
