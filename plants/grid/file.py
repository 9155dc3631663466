"""Read the file of a grid, with the network of another source that it may name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from zenostat.bridge.python_plant.shipped import PANDAPOWER
from zenostat.plants.grid.schema import Grid, Profile, SessionFile
from zenostat.topics import yaml12
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidConfig

_NETWORK = "network"


def read_grid(source: str, overrides: dict[str, Any]) -> tuple[Grid, Path, dict[str, str]]:
    """Read a grid.

    Args:
        source: YAML file, or `pandapower:NAME`.
        overrides: fields in place of those of the file.

    Returns:
        The grid, the folder to which its paths are relative, and its files by their role.

    Raises:
        InvalidConfig: the file cannot be read or is not valid; lists all errors.
    """
    if source.startswith(PANDAPOWER):
        return _validate(_network(source) | overrides, source), Path.cwd(), {}
    path = Path(source).absolute()
    mapping = yaml12.read_mapping(path)
    if _NETWORK in mapping:
        mapping = _merge(_network(str(mapping.pop(_NETWORK))), mapping, path)
    grid = _validate({"name": path.stem, **mapping, **overrides}, str(path))
    files = {f"profile {name}": str(path.parent / name) for name in sorted(set(_file_names(grid)))}
    return grid, path.parent, {"grid": str(path), **files}


def _network(source: str) -> dict[str, Any]:
    if not source.startswith(PANDAPOWER):
        raise InvalidConfig(f"network: {source!r}; pandapower:NAME expected, such as pandapower:cigre_lv")
    from zenostat.plants.grid.pandapower import read_network  # an extra of its own

    return read_network(source.removeprefix(PANDAPOWER))


def _merge(network: dict[str, Any], mapping: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return a network with what a file adds to it."""
    merged = dict(network)
    for name, value in mapping.items():
        present = merged.get(name)
        if isinstance(present, dict) and isinstance(value, dict) and name != "source":
            if twice := sorted(present.keys() & value.keys()):
                raise InvalidConfig(f"{path}: {name}: the network has {', '.join(map(str, twice))} already")
            merged[name] = {**present, **value}
        else:
            merged[name] = value
    return merged


def _validate(mapping: Mapping[str, Any], what: str) -> Grid:
    try:
        return Grid.model_validate(mapping)
    except ValidationError as error:
        raise InvalidConfig(f"{what}: {describe_validation_errors(error, Grid.model_fields)}") from None


def _file_names(grid: Grid) -> Iterator[str]:
    powers = [*(load.power_w for load in grid.loads.values()), *(pv.power_w for pv in grid.pv.values())]
    yield from (power.file for power in powers if isinstance(power, Profile))
    if grid.price is not None and isinstance(grid.price.price, Profile):
        yield grid.price.price.file
    for charger in grid.chargers.values():
        if isinstance(charger.sessions, SessionFile):
            yield charger.sessions.file
