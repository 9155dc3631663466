"""Upgrade a model of an earlier version to the engine's, or refuse it by object, field and line.

EnergyPlus itself only warns about another version and ignores fields that have since been renamed. Here an IDF is read
with the input format of its own version, each version step applies its rules, and the result is checked against the
engine's schema, so a change that no rule covers is an error and never a silently ignored field.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from zenostat.models import energyplus, schema
from zenostat.models.input_format.epjson_reader import read_epjson
from zenostat.models.input_format.idf_reader import idf_version, read_idf, version_line
from zenostat.models.input_format.source_model import ObjectsOfType, SourceModel
from zenostat.models.upgrade.apply import apply
from zenostat.models.upgrade.step import Change, Refusal, UpgradingModel
from zenostat.models.upgrade.versions import layout_of, short, steps_between
from zenostat.topics.errors import InvalidConfig, list_errors
from zenostat.topics.plurals import counted


@dataclass(frozen=True)
class UpgradedModel:
    """A model of the engine's version.

    Attributes:
        objects: object type, object name, fields.
        before, after: its own version, and the engine's; equal if nothing was to do.
        changes: what was changed, in order.
    """

    objects: dict[str, ObjectsOfType]
    before: str
    after: str
    changes: tuple[Change, ...] = ()

    @property
    def summary(self) -> str:
        """A sentence on the upgrade; empty if there was none."""
        if self.before == self.after:
            return ""
        head = f"upgraded from EnergyPlus {self.before} to {self.after}"
        if not self.changes:
            return f"{head}: nothing had to be changed"
        objects = len({(change.kind, change.name) for change in self.changes})
        return (
            f"{head}: {counted(len(self.changes), 'change')} in {counted(objects, 'object')} "
            "(`zenostat models upgrade FILE` lists them)"
        )


def upgrade_idf(text: str, *, name: str, engine: str | None = None) -> UpgradedModel:
    """Read an IDF of a known version and upgrade it; one without a version is read as the engine's, as EnergyPlus does.

    Raises:
        InvalidConfig: the version cannot be upgraded, the text is not an IDF of its version, or no rule covers what
            changed.
    """
    engine = engine or energyplus.version()
    version = idf_version(text)
    line = version_line(text)
    steps_between(version, engine, f"{name}, line {line}" if line else name)
    own = short(version) if version else short(engine)
    return _upgrade(read_idf(text, layout_of(own, name=name), name=name), version, name, engine)


def upgrade_epjson(
    objects: Mapping[str, Any], *, name: str, text: str = "", engine: str | None = None
) -> UpgradedModel:
    """Upgrade a whole epJSON; the input is not modified, and one of the engine's version is used as it is.

    Args:
        objects: of the file.
        name: of the file.
        text: of the file; without it, errors have no lines.
        engine: the version to upgrade to; None for the installed one.

    Raises:
        InvalidConfig: it is not an epJSON, its version cannot be upgraded, or no rule covers what changed.
    """
    if not all(isinstance(items, Mapping) and _all_fields(items) for items in objects.values()):
        raise InvalidConfig(
            "\n".join([f"{name} is not an epJSON file:", *schema.schema_errors(objects, complete=False)])
        )
    version = next((fields.get("version_identifier") for fields in objects.get("Version", {}).values()), None)
    return _upgrade(SourceModel(objects=dict(objects)), version, name, engine or energyplus.version(), text)


def _all_fields(items: Mapping[str, Any]) -> bool:
    return all(isinstance(fields, Mapping) for fields in items.values())


def _entry_errors(objects: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[str]:
    """Yield an error for each entry of a list that is no object, which no rule expects."""
    for kind, items in objects.items():
        for name, fields in items.items():
            for field, value in fields.items():
                for index, entry in enumerate(value if isinstance(value, list) else ()):
                    if not isinstance(entry, Mapping):
                        yield f"{kind} {name!r}: {field}[{index}] is {entry!r}; expected fields by name"


def _upgrade(source: SourceModel, version: object, name: str, engine: str, epjson: str = "") -> UpgradedModel:
    steps = steps_between(version, engine, name)
    target = short(engine)
    if not steps:
        return UpgradedModel(source.objects, target, target)
    if errors := list(_entry_errors(source.objects)):
        raise InvalidConfig(list_errors(f"{name} is not an epJSON file:", errors))
    model = UpgradingModel(source.objects)
    for step in steps:
        apply(step, model)
    _respell(model)
    model.objects["Version"] = {key: {"version_identifier": target} for key in list(model.objects["Version"])[:1]}
    refusals = [*model.refusals, *_schema_refusals(model)]
    if refusals:
        source = read_epjson(epjson) if epjson else source
        lines = list(dict.fromkeys(_describe(refusal, source) for refusal in refusals))
        head = f"{name} is for EnergyPlus {version} and cannot be upgraded to {target}:"
        raise InvalidConfig(list_errors(head, lines))
    return UpgradedModel(model.objects, steps[0].before, target, tuple(model.changes))


def _respell(model: UpgradingModel) -> None:
    """Spell words as the engine's schema does: in any case, an earlier version took those that it had no list of."""
    for kind, items in model.objects.items():
        spelling = schema.canonical_type(kind) or kind
        for name, fields in items.items():
            items[name] = schema.canonical_fields(spelling, fields)


def _schema_refusals(model: UpgradingModel) -> Iterator[Refusal]:
    """Yield what the engine's schema rejects in the result, under the names of the user's file."""
    refused = {(refusal.kind, refusal.name) for refusal in model.refusals}
    for kind, items in model.objects.items():
        spelling = schema.canonical_type(kind) or kind
        if not schema.schema_errors({spelling: items}, complete=True):
            continue
        for name, fields in (items or {"": {}}).items():
            origin = model.origin(kind, name)
            errors = [] if origin in refused else schema.schema_errors({spelling: {name: fields}}, complete=True)
            for error in errors:
                text = error.removeprefix(f"{spelling} {name!r}").removeprefix(spelling).removeprefix(":").strip()
                yield Refusal(*origin, _field_in(text, fields, model, kind, name), text)
        if len(items) > 1 and schema.single(spelling):
            yield Refusal(*model.origin(kind, next(iter(items))), "", f"a model has only one, got {len(items)}")


def _field_in(text: str, fields: Mapping[str, Any], model: UpgradingModel, kind: str, name: str) -> str:
    """Return the field of the user's file that an error is about; empty if it is about the object."""
    words = text.replace("'", " ").replace("[", " ").replace(":", " ").split()
    named = next((field for field in fields if field in words), "")
    return model.renamed_fields.get((kind, name, named), named)


def _describe(refusal: Refusal, source: SourceModel) -> str:
    line = source.line(refusal.kind, refusal.name, refusal.field)
    place = f"line {line}: " if line is not None else ""
    label = f"{refusal.kind} {refusal.name!r}" if refusal.name else refusal.kind
    return f"{place}{label}: {refusal.text}"
