"""A wrapper that leaves only numbers in the infos, for libraries that convert each entry to a tensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from zenostat.agent_sdk.wrappers.adapters import BuildingWrapper
from zenostat.agent_sdk.wrappers.base import WrapperLogic


class _Logic(WrapperLogic):
    @override
    def convert_infos(self, infos: dict[str, Any]) -> dict[str, Any]:
        return _numbers(infos)


def _numbers(infos: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    numbers: dict[str, Any] = {}
    for key, value in infos.items():
        is_mask = key.startswith("_") and key[1:] in infos
        if is_mask or (key == "action" and not prefix):
            continue
        if key == "final_info":  # Gymnasium's own entry, which stays a dictionary
            numbers[key] = _numbers(value)
        elif isinstance(value, Mapping):
            numbers |= _numbers(value, f"{prefix}{key}.")
            continue
        elif key == "final_obs" or (np.asarray(value).dtype.kind in "biuf" and np.size(value)):
            numbers[prefix + key] = value
        else:
            continue
        if f"_{key}" in infos:
            numbers[f"_{prefix}{key}"] = infos[f"_{key}"]
    return numbers


class NumericInfos(BuildingWrapper):
    """Leave only numbers in the infos: TorchRL converts each entry of a vector's infos to a tensor.

    Texts such as `time` and `weather` are left out, and so is `action`, which TorchRL has itself. Nested entries become
    entries of their own: `infos["reward_terms"]["energy"]` is `infos["reward_terms.energy"]`. Apply it last: other
    wrappers need what it leaves out.
    """

    logic = _Logic
