"""Apply the tables of a version step to a model."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from zenostat.models.upgrade.step import Renames, UpgradingModel, VersionStep
from zenostat.models.upgrade.variable_names import rename_variables


def apply(step: VersionStep, model: UpgradingModel) -> None:
    """Upgrade a model by one step, in place."""
    model.begin(step.before, step.after)
    for kind, reason in step.refused.items():
        for name, _ in model.items(kind):
            model.refuse(kind, name, reason)
    for old, new in step.types.items():
        model.rename_type(old, new)
    _rename_fields(step, model)
    _collect_lists(step, model)
    _name_objects(step, model)
    _drop(step, model)
    _keep_defaults(step, model)
    _rename_words(step, model)
    if step.variables:
        rename_variables(model, step.variables)
    for function in step.functions:
        function(model)


def _rename_fields(step: VersionStep, model: UpgradingModel) -> None:
    for kind, renames in step.fields.items():
        for name, fields in model.items(kind):
            for old in list(fields):
                if new := _renamed(old, renames):
                    model.rename_field(model.find(kind) or kind, name, old, new)
    for kind, (list_name, renames) in step.entries.items():
        for name, fields in model.items(kind):
            entries = fields.get(list_name, [])
            fields[list_name] = [{_renamed(k, renames) or k: v for k, v in entry.items()} for entry in entries]
            for old in dict.fromkeys(key for entry in entries for key in entry):
                if new := _renamed(old, renames):
                    model.note(kind, name, f"{old} in {list_name} is now {new}")


def _collect_lists(step: VersionStep, model: UpgradingModel) -> None:
    for kind, (list_name, patterns) in step.listed.items():
        for name, fields in model.items(kind):
            kept, entries = _collect(fields, patterns)
            if entries:
                fields.clear()
                fields.update(kept | {list_name: [*kept.get(list_name, []), *entries]})
                model.note(kind, name, f"its numbered fields are now the list {list_name}")


def _name_objects(step: VersionStep, model: UpgradingModel) -> None:
    for kind, source in step.named.items():
        own = model.find(kind)
        if own and any(source in fields for _, fields in model.items(kind)):
            named = {}
            for name, fields in model.items(kind):
                new = str(fields.pop(source, name))
                named[new] = fields
                model.origins[own, new] = model.origin(own, name)
                model.note(kind, new, f"{source} is now the object's name")
            model.objects[own] = named


def _drop(step: VersionStep, model: UpgradingModel) -> None:
    for kind, removed in step.dropped.items():
        for name, fields in model.items(kind):
            for field_name in removed:
                if fields.pop(field_name, None) is not None:
                    model.note(kind, name, f"{field_name} had no effect and was removed")


def _keep_defaults(step: VersionStep, model: UpgradingModel) -> None:
    for kind, defaults in step.defaults.items():
        for name, fields in model.items(kind):
            for field_name, value in defaults.items():
                if fields.get(field_name, "") == "":
                    fields[field_name] = value
                    model.note(kind, name, f"{field_name} stays {value}, which is no longer its default")


def _rename_words(step: VersionStep, model: UpgradingModel) -> None:
    for kind_pattern, field_pattern, words in step.words:
        folded = {old.casefold(): new for old, new in words.items()}
        for kind, items in model.objects.items():
            if re.fullmatch(kind_pattern, kind, re.IGNORECASE):
                for name, fields in items.items():
                    for key, old, new in _replace_words(fields, re.compile(field_pattern), folded):
                        model.note(kind, name, f"{key} {old!r} is now {new!r}")


def _renamed(name: str, renames: Renames) -> str | None:
    """Return the new name of a field; None if no pattern matches."""
    for pattern, template in renames:
        if match := re.fullmatch(pattern, name):
            return match.expand(template)
    return None


def _collect(fields: Mapping[str, Any], patterns: Renames) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Split fields into those that stay, and the entries that numbered ones become."""
    kept: dict[str, Any] = {}
    entries: dict[int, dict[str, Any]] = {}
    for name, value in fields.items():
        for pattern, entry_field in patterns:
            if match := re.fullmatch(pattern, name):
                entries.setdefault(int(match[1]), {})[entry_field] = value
                break
        else:
            kept[name] = value
    return kept, [entries[number] for number in sorted(entries)]


def _replace_words(
    fields: dict[str, Any], pattern: re.Pattern[str], words: Mapping[str, str]
) -> Iterator[tuple[str, str, str]]:
    """Replace choices in place; yield field, old and new one."""
    for key, value in fields.items():
        if isinstance(value, list):
            for entry in value:
                if isinstance(entry, dict):
                    yield from _replace_words(entry, pattern, words)
        elif isinstance(value, str) and pattern.fullmatch(key):
            new = words.get(value.casefold())
            if new is not None and new != value:
                fields[key] = new
                yield key, value, new
