"""Trace dangling references of expanded HVACTemplate objects to the templates that they come from."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from zenostat.models.building.references import DanglingReference, dangling_references
from zenostat.models.input_format.source_model import ModelObjects

_PREFIX = "hvactemplate:"


class TracedReference(NamedTuple):
    """A dangling reference, and whether EnergyPlus ends because of it."""

    reference: DanglingReference
    is_fatal: bool


def is_template(kind: str) -> bool:
    """Return whether an object type is one of HVACTemplate."""
    return kind.casefold().startswith(_PREFIX)


def templates_of(objects: ModelObjects) -> dict[str, Mapping[str, Any]]:
    """Return the HVACTemplate objects of a model."""
    return {kind: items for kind, items in objects.items() if is_template(kind) and items}


def traced_references(objects: ModelObjects, unexpanded: ModelObjects) -> Iterator[TracedReference]:
    """Yield the dangling references of a model, those of templates in place of what follows from them.

    ExpandObjects copies a name, or makes others from it: `all` becomes `all Dual SP Control`. A template's reference
    is fatal if one that follows from it is.

    Args:
        objects: the model, its templates expanded.
        unexpanded: the model as it is in the user's file; empty if it has no templates.
    """
    templates = templates_of(unexpanded)
    references = list(dangling_references({**objects, **templates}))
    rest = [each for each in references if not is_template(each.kind)]
    for each in references:
        if is_template(each.kind):
            following = list(_following(each, rest, unexpanded))
            rest = [other for other in rest if other not in following]
            yield TracedReference(each, any(other.is_fatal for other in following))
    yield from (TracedReference(each, each.is_fatal) for each in rest)


def _following(
    reference: DanglingReference, others: Iterable[DanglingReference], unexpanded: ModelObjects
) -> Iterator[DanglingReference]:
    """Yield the references of expanded objects whose names are made of a template's."""
    pattern = re.compile(rf"(?<!\w){re.escape(reference.value)}(?!\w)", re.IGNORECASE)
    for each in others:
        if each.name not in unexpanded.get(each.kind, {}) and pattern.search(each.value):
            yield each
