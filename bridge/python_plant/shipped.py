"""Classes of plants that come with Zenostat and have an option of their own: `--fmu plant.fmu` in place of a class."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zenostat.topics.errors import InvalidConfig

SHIPPED: Mapping[str, str] = {
    "fmu": "zenostat.plants.fmi.plant:FmuPlant",
    "grid": "zenostat.plants.grid.plant:GridPlant",
}
"""Class by the name of its setting, whose value is the class's argument `file`."""

PLANT_SETTINGS = {"plant", *SHIPPED}
"""Settings that name a plant in place of a building."""

PANDAPOWER = "pandapower:"
"""Prefix of a grid that is one of pandapower's networks, and not a file."""


def absolute_source(name: str) -> str:
    """Return the path of a shipped plant's file as an absolute one; the name of a network as it is."""
    return name if name.startswith(PANDAPOWER) else str(Path(name).expanduser().absolute())


def shipped_plant(option: str, source: str, arguments: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return class and arguments of a shipped plant.

    Args:
        option: a key of `SHIPPED`.
        source: its file.
        arguments: further arguments of the class.

    Raises:
        InvalidConfig: the arguments name the file as well.
    """
    if "file" in arguments:
        raise InvalidConfig(f"plant_arguments: file = {arguments['file']!r} conflicts with {option} = {source!r}")
    return SHIPPED[option], {"file": absolute_source(source), **arguments}


def shipped_option(plant: str) -> str | None:
    """Return the option of a shipped class; None for a class of the user's."""
    return next((option for option, name in SHIPPED.items() if name == plant), None)
