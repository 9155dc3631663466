"""The points that a reward reads, by name or by what EnergyPlus calls them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topics.errors import InvalidConfig, did_you_mean
from topics.messages import Manifest

HVAC_POWER = "Facility Total HVAC Electricity Demand Rate"
ZONE_TEMPERATURES = ("zone air temperature", "zone mean air temperature")

Indices = NDArray[np.intp]
"""Places among the values of a sample."""


def indices(found: Sequence[int]) -> Indices:
    """As NumPy takes them fastest."""
    return np.array(found, np.intp)


def sum_at(values: NDArray[np.float64], at: Indices) -> Any:
    """The sum of some points, with the leading shape of `values`."""
    if len(at) == 1:
        return values.take(at[0], axis=-1)
    return np.add.reduce(values.take(at, axis=-1), axis=-1)


def named(kind: str, name: str, manifest: Manifest, units: Sequence[str]) -> int:
    """The index of a sensor of one of these units; `InvalidConfig` if it is not there or of another one."""
    there = {s.name: s.unit for s in manifest.sensors}
    fit = [n for n, unit in there.items() if unit in units]
    if name not in manifest.names:
        raise InvalidConfig(
            f"the {kind} reward names {name!r}, which the node does not have; {did_you_mean(name, fit)}"
        )
    if there.get(name) not in units:
        wanted = " or ".join(units)
        raise InvalidConfig(
            f"the {kind} reward needs a sensor in {wanted}, which {name!r} is not; {did_you_mean(name, fit)}"
        )
    return manifest.names.index(name)


def of_variables(manifest: Manifest, *variables: str) -> list[int]:
    """The sensors of the first of these output variables (in lower case) that is there at all."""
    for variable in variables:
        found = [i for i, s in enumerate(manifest.sensors) if s.variable.casefold() == variable]
        if found:
            return found
    return []


def powers(kind: str, names: Sequence[str] | None, manifest: Manifest) -> Indices:
    """The sensors of electric power in W: those that are named, else that of all HVAC."""
    if names is not None:
        return indices([named(kind, name, manifest, ["W"]) for name in names])
    found = of_variables(manifest, HVAC_POWER.casefold())
    if not found:
        raise InvalidConfig(
            f"the {kind} reward needs a sensor of '{HVAC_POWER}' (key 'Whole Building'): "
            "name one in sensors=, or name another power sensor as the reward's `power`"
        )
    return indices(found[:1])


def temperatures(kind: str, names: Sequence[str] | None, manifest: Manifest) -> Indices:
    """The sensors of zones' air temperatures in degC: those that are named, else all."""
    if names is not None:
        return indices([named(kind, name, manifest, ["degC"]) for name in names])
    found = of_variables(manifest, *ZONE_TEMPERATURES)
    if not found:
        raise InvalidConfig(
            f"the {kind} reward needs at least one sensor of 'Zone Air Temperature': name one in sensors=, "
            "or name the temperature sensors as the reward's `temperatures`"
        )
    return indices(found)


def same_zone(zones: Sequence[int], variable: str, manifest: Manifest) -> list[int | None]:
    """For each of these sensors the one of another output variable with the same key; None where there is none."""
    there = {
        s.key.casefold(): i
        for i, s in reversed(list(enumerate(manifest.sensors)))
        if s.variable.casefold() == variable.casefold()
    }
    return [there.get(manifest.sensors[zone].key.casefold()) for zone in zones]
