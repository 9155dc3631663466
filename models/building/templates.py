"""Expand HVACTemplate objects with EnergyPlus's own preprocessor, ExpandObjects.

The engine itself does not know these objects. ExpandObjects reads an IDF and adds to it the systems that they stand
for. It is in the wheel, sometimes without the permission to execute it, and needs a data dictionary beside the file,
which the wheel lacks; so a copy of it runs in a scratch folder, with a dictionary made from the schema.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

from zenostat.models import energyplus, schema
from zenostat.models.building.template_references import templates_of
from zenostat.models.input_format.encoding import decode_idf
from zenostat.models.input_format.idd import dictionary
from zenostat.models.input_format.idf_reader import read_idf
from zenostat.models.input_format.idf_writer import write_idf
from zenostat.models.input_format.layout import engine_layout
from zenostat.models.input_format.source_model import ObjectsOfType, SourceModel
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.errors import InvalidConfig, ModelError, list_errors
from zenostat.topics.plurals import counted

_FORMAT = "2"
_MAX_NAME = 100
"""Length at which ExpandObjects cuts names."""

_TIMEOUT_S = 60.0
_NOT_PASSED = ("energymanagementsystem:", "output", "meter:", "pythonplugin:")
"""Prefixes of types that ExpandObjects does not use; their texts may contain what an IDF cannot."""

_MESSAGE = "Output:PreprocessorMessage"


def expand(objects: dict[str, ObjectsOfType], *, file: str) -> tuple[dict[str, ObjectsOfType], tuple[str, ...]]:
    """Return the model with its templates expanded, and notes: the numbers of objects, and ExpandObjects's warnings.

    The result is cached by content. Objects that are not templates are unchanged.

    Args:
        objects: a model of the engine's version.
        file: path of its file, for error messages.

    Raises:
        InvalidConfig: a template does not match the schema, or ExpandObjects rejects one.
        ModelError: ExpandObjects failed.
    """
    templates = templates_of(objects)
    if not templates:
        return objects, ()
    if errors := schema.schema_errors(templates, complete=True):
        _reject(file, errors)
    passed = {kind: items for kind, items in objects.items() if not kind.casefold().startswith(_NOT_PASSED)}
    passed |= {kind: _with_words(kind, items) for kind, items in templates.items()}
    if long := [f"{kind} {name!r}" for kind, items in passed.items() for name in items if len(name) > _MAX_NAME]:
        _reject(file, [f"{name} has {_MAX_NAME + 1} or more characters; use shorter names" for name in long])
    try:
        text = write_idf(passed, engine_layout(), all_fields=True)
    except InvalidConfig as error:
        _reject(file, [f"ExpandObjects reads IDFs alone: {error}"])
    name = f"models/{digest(text, energyplus.version())}-expanded-{_FORMAT}.idf"
    result_text = decode_idf(cached_bytes(name, lambda target: _run(text, target, file)))
    expanded = read_idf(result_text, engine_layout(), name=f"{file}, with its templates expanded,")
    messages = list(_messages(expanded))
    if fatal := [message for severity, message in messages if severity in ("severe", "fatal")]:
        _reject(file, fatal)
    added = _added(expanded.objects, passed)
    if errors := schema.schema_errors(added, complete=True):
        _reject(file, [f"in the result, {error}" for error in errors])
    result = {kind: dict(items) for kind, items in objects.items() if kind not in templates}
    for kind, items in added.items():
        result[kind] = _joined(kind, result.get(kind, {}), items)
    count, total = (sum(map(len, part.values())) for part in (templates, added))
    note = f"{counted(count, 'HVACTemplate object')} expanded to {total} objects by ExpandObjects"
    return result, (note, *(message for severity, message in messages if severity == "warning"))


def _with_words(kind: str, items: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return templates with the schema's default in each empty field whose default is a word.

    ExpandObjects's own defaults of some of these fields are words of earlier versions, which it then rejects: `None`
    for an economizer, `ConstantFlow` for a chilled water loop.
    """
    entry = engine_layout().find(kind)
    rules = entry.rules if entry is not None else {}
    words = {name: rule["default"] for name, rule in rules.items() if isinstance(rule.get("default"), str)}
    return {name: words | dict(fields) for name, fields in items.items()}


def _reject(file: str, errors: list[str]) -> NoReturn:
    raise InvalidConfig(list_errors(f"{file}: its HVACTemplate objects cannot be expanded:", errors))


def _run(text: str, target: Path, file: str) -> None:
    """Run a copy of ExpandObjects on an IDF and write what it makes of it to `target`."""
    source = energyplus.library().with_name("ExpandObjects")
    if not source.exists():
        raise ModelError(f"{file} has HVACTemplate objects, but there is no ExpandObjects at {source}")
    with tempfile.TemporaryDirectory(prefix="expand-", dir=target.parent) as folder:
        scratch = Path(folder)
        program = shutil.copyfile(source, scratch / "ExpandObjects")
        program.chmod(0o700)
        (scratch / "Energy+.idd").write_bytes(dictionary())
        (scratch / "in.idf").write_text(text, encoding="utf-8")
        try:
            finished = subprocess.run(
                [program], cwd=scratch, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=_TIMEOUT_S
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ModelError(f"ExpandObjects could not expand {file}: {error}") from None
        result = scratch / "expanded.idf"
        if not result.exists():
            output = (finished.stdout + finished.stderr).decode(errors="replace").strip().splitlines()[-5:]
            head = f"ExpandObjects could not expand {file}. It exited with code {finished.returncode} and this output:"
            raise ModelError("\n  ".join([head, *output]))
        shutil.copyfile(result, target)


def _messages(expanded: SourceModel) -> Iterator[tuple[str, str]]:
    """Yield severity and text of ExpandObjects's messages, which it leaves as objects."""
    for each in expanded.entries:
        if each.kind == _MESSAGE and len(each.fields) > 1:
            _, severity, *lines = (field.text for field in each.fields.values())
            yield severity.casefold(), " ".join(lines)


def _added(expanded: dict[str, ObjectsOfType], passed: Mapping[str, Mapping[str, Any]]) -> dict[str, ObjectsOfType]:
    """Return the objects that ExpandObjects added; it copies those of the model first, in their order."""
    added = {}
    for kind, items in expanded.items():
        copied = len(passed.get(kind, {}))
        if kind != _MESSAGE and len(items) > copied:
            added[kind] = dict(list(items.items())[copied:])
    return added


def _joined(kind: str, own: Mapping[str, Any], added: Mapping[str, Any]) -> dict[str, Any]:
    """Return both groups of objects; added objects of a type without names get unused numbers."""
    entry = engine_layout().find(kind)
    joined = dict(own)
    for name, fields in added.items():
        key, number = name, len(joined)
        while key in joined and entry is not None and not entry.named:
            number += 1
            key = f"{kind} {number}"
        joined[key] = fields
    return joined
