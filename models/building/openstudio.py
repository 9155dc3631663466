"""Translate OpenStudio models and gbXML files to IDF with OpenStudio's own translators, in a separate process.

An earlier OSM is updated by OpenStudio's version translator first. Measures are not run. The child process is this
module as a program: `python -m zenostat.models.building.openstudio SOURCE TARGET`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

from zenostat.models import energyplus
from zenostat.models.energyplus import ISOLATED
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.errors import InvalidConfig, MissingExtra

SUFFIXES = (".osm", ".gbxml", ".xml")
"""Suffixes of the files that OpenStudio reads; `.xml` is a gbXML."""

_FORMAT = "4"
_MAX_NOTES = 5


class TranslatedModel(NamedTuple):
    """An IDF, and what OpenStudio reported of the translation."""

    idf: str
    notes: tuple[str, ...]


def translate(path: Path) -> TranslatedModel:
    """Translate an OSM or gbXML file to IDF; cached by its content and OpenStudio's version.

    Raises:
        MissingExtra: OpenStudio is not installed.
        InvalidConfig: OpenStudio cannot read the file.
    """
    try:
        installed = version("openstudio")
    except PackageNotFoundError:
        raise MissingExtra(
            f"{path} needs OpenStudio, which translates it to IDF: pip install openstudio (300 MB; the extra "
            "`openstudio`)"
        ) from None
    key = digest(path.read_bytes(), energyplus.version(), installed, _FORMAT)
    result = json.loads(cached_bytes(f"openstudio/{key}.json", lambda target: _call(path, target)))
    return TranslatedModel(result["idf"], tuple(result["notes"]))


def _call(path: Path, target: Path) -> None:
    finished = subprocess.run(
        [*ISOLATED, "zenostat.models.building.openstudio", str(path), str(target)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,  # OpenStudio repeats its messages there, some for each object
        stderr=subprocess.DEVNULL,
        check=False,
    )
    if not target.exists():
        raise InvalidConfig(f"OpenStudio could not translate {path}: it exited with code {finished.returncode}")
    result: dict[str, Any] = json.loads(target.read_bytes())
    if "idf" not in result:
        kind = "an OpenStudio model" if path.suffix.lower() == ".osm" else "a gbXML file"
        raise InvalidConfig("\n  ".join([f"{path} is not {kind} that OpenStudio can read:", *result["errors"][:10]]))


def _translate(source: str, target: str) -> None:
    import openstudio

    path = openstudio.toPath(source)
    is_osm = source.lower().endswith(".osm")
    reader = openstudio.osversion.VersionTranslator() if is_osm else openstudio.gbxml.GbXMLReverseTranslator()
    loaded = reader.loadModel(path)
    installed = openstudio.openStudioVersion()
    result: dict[str, Any] = {"errors": _texts(reader.errors()) or ["it has no model"]}
    if loaded.is_initialized():
        writer = openstudio.energyplus.ForwardTranslator()
        model = loaded.get()
        if not is_osm:
            _complete(model)
        workspace = writer.translateModel(model)
        errors = _texts(writer.errors())
        result = {"errors": errors}
        if not errors:
            own = reader.originalVersion().str() if is_osm else ""
            head = f"translated by OpenStudio {installed}" + (f" from {own}" if own not in ("", installed) else "")
            warnings = _texts([*reader.warnings(), *writer.warnings()])
            more = [f"OpenStudio: {len(warnings) - _MAX_NOTES} more warnings"] * (len(warnings) > _MAX_NOTES)
            notes = [head, *(f"OpenStudio: {text}" for text in warnings[:_MAX_NOTES]), *more]
            result = {"idf": str(workspace), "notes": notes}
    Path(target).write_text(json.dumps(result))


def _complete(model: Any) -> None:
    """Remove what a gbXML has and EnergyPlus ends at: constructions without layers, spaces without surfaces."""
    for construction in model.getConstructions():
        if construction.numLayers() == 0:
            construction.remove()
    for space in model.getSpaces():
        if not space.surfaces():
            zone = space.thermalZone()
            space.remove()
            if zone.is_initialized():
                zone.get().remove()


def _texts(messages: Any) -> list[str]:
    return list(dict.fromkeys(" ".join(message.logMessage().split()) for message in messages))


if __name__ == "__main__":
    _translate(*sys.argv[1:])
