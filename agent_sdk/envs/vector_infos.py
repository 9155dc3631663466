"""Infos of a vector of environments in Gymnasium's form: arrays with a value a slot, and `_key`: which slots have one.

A dictionary within has the same form. It is what `gymnasium.vector.VectorEnv` makes of each slot's own info, without
making those first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Infos = dict[str, Any]
Slots = NDArray[np.bool_]
"""Which slots, shape (slots,)."""


def masked(found: Mapping[str, Any], slots: Slots) -> Infos:
    """Arrays with a value for each slot (or numbers that hold for all), as infos that all these slots have.

    What is read-only is copied: infos belong to who gets them.
    """
    told: Infos = {}
    for key, value in found.items():
        told[key] = masked(value, slots) if isinstance(value, dict) else _array(value, len(slots))
        told[f"_{key}"] = slots
    return told


def select(infos: Infos, slots: Slots) -> Infos:
    """The infos of these slots alone; what none of them has is left out."""
    told: Infos = {}
    for key, value, has in _pairs(infos):
        kept = has & slots
        if kept.any():
            told[key] = select(value, slots) if isinstance(value, dict) else _put(_blank(value), value, kept)
            told[f"_{key}"] = kept
    return told


def merge(one: Infos, other: Infos) -> Infos:
    """Both together; where a slot has a key in both, `other` goes before."""
    told = dict(one)
    for key, value, has in _pairs(other):
        if key in one:
            before = one[key]
            told[key] = merge(before, value) if isinstance(value, dict) else _put(before.copy(), value, has)
            told[f"_{key}"] = one[f"_{key}"] | has
        else:
            told[key], told[f"_{key}"] = value, has
    return told


def unbatch(infos: Infos, slot: int) -> dict[str, Any]:
    """One slot's own info, as a single environment gives it."""
    told: dict[str, Any] = {}
    for key, value, has in _pairs(infos):
        if has[slot]:
            told[key] = unbatch(value, slot) if isinstance(value, dict) else _plain(value[slot])
    return told


def _pairs(infos: Infos) -> list[tuple[str, Any, Slots]]:
    return [(key, value, infos[f"_{key}"]) for key, value in infos.items() if f"_{key}" in infos]


def _array(value: Any, count: int) -> NDArray[Any]:
    if isinstance(value, np.ndarray) and value.ndim:
        return value if value.flags.writeable else value.copy()
    return np.full(count, value)


def _blank(value: NDArray[Any]) -> NDArray[Any]:
    return np.full(value.shape, None, object) if value.dtype == object else np.zeros_like(value)


def _put(array: NDArray[Any], values: NDArray[Any], slots: Slots) -> NDArray[Any]:
    array[slots] = values[slots]
    return array


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
