"""Infos of a vector of environments in Gymnasium's form: arrays with a value for each slot, and `_key` marking slots.

`infos["_key"]` says which slots have a value of `key`; nested dictionaries have the same form. The functions here give
the result of `gymnasium.vector.VectorEnv` without building an info for each slot first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Infos = dict[str, Any]
Slots = NDArray[np.bool_]
"""Mask of slots, shape (slots,)."""


def masked(entries: Mapping[str, Any], slots: Slots) -> Infos:
    """Convert arrays with a value for each slot, or numbers for all slots, to infos of the slots in `slots`.

    Read-only arrays are copied, because infos belong to their receiver.
    """
    infos: Infos = {}
    for key, value in entries.items():
        infos[key] = masked(value, slots) if isinstance(value, dict) else _array(value, len(slots))
        infos[f"_{key}"] = slots
    return infos


def select(infos: Infos, slots: Slots) -> Infos:
    """Return the infos of these slots alone, without keys that none of them has."""
    selected: Infos = {}
    for key, value, mask in _items(infos):
        kept = mask & slots
        if kept.any():
            selected[key] = select(value, slots) if isinstance(value, dict) else _put(_blank(value), value, kept)
            selected[f"_{key}"] = kept
    return selected


def merge(first: Infos, second: Infos) -> Infos:
    """Return both together; where a slot has a key in both, the value of `second`."""
    merged = dict(first)
    for key, value, mask in _items(second):
        if key in first:
            before = first[key]
            merged[key] = merge(before, value) if isinstance(value, dict) else _put(before.copy(), value, mask)
            merged[f"_{key}"] = first[f"_{key}"] | mask
        else:
            merged[key], merged[f"_{key}"] = value, mask
    return merged


def unbatch(infos: Infos, slot: int) -> dict[str, Any]:
    """Return the info of one slot in the form of a single environment."""
    info: dict[str, Any] = {}
    for key, value, mask in _items(infos):
        if mask[slot]:
            info[key] = unbatch(value, slot) if isinstance(value, dict) else _plain(value[slot])
    return info


def _items(infos: Infos) -> list[tuple[str, Any, Slots]]:
    """Return triples of key, value and mask."""
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
