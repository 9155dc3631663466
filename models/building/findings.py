"""Findings of rules on a model's objects: what EnergyPlus does not accept, and what a model hardly means."""

from __future__ import annotations

from typing import NamedTuple


class FieldFinding(NamedTuple):
    """A finding on a field of a known object.

    Attributes:
        field: its path, such as `data[3].field`; empty if it is about the object.
        text: what is wrong, to follow the object's name.
        is_fatal: whether EnergyPlus ends because of it.
    """

    field: str
    text: str
    is_fatal: bool = True


class RuleFinding(NamedTuple):
    """A finding on an object of a model.

    Attributes:
        kind, name, field: the object and the path of its field, which is empty if it is about the object.
        text: the whole sentence.
        is_fatal: whether EnergyPlus ends because of it.
    """

    kind: str
    name: str
    field: str
    text: str
    is_fatal: bool


def finding(kind: str, name: str, of_field: FieldFinding) -> RuleFinding:
    """Return a field's finding with the object that it is about."""
    return RuleFinding(kind, name, of_field.field, f"{kind} {name!r}{of_field.text}", of_field.is_fatal)
