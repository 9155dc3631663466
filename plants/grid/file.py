"""Read the file of a grid, with the network of another source that it may name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from zenostat.bridge.python_plant.shipped import PANDAPOWER
from zenostat.plants.grid.schema import Grid, Profile, SessionFile
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, list_errors
from zenostat.topics.model_file import located_errors
from zenostat.topics.user_file import user_file
from zenostat.topics.yaml12 import Lines

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
        return _validate(_network(source) | overrides, source, Lines()), Path.cwd(), {}
    path = Path(source).absolute()
    with user_file(path, expected="a YAML file"):
        text = yaml12.read_text(path)
    mapping, lines = yaml12.parse_with_lines(text, str(path))
    if _NETWORK in mapping:
        mapping = _merge(_network(str(mapping.pop(_NETWORK))), mapping, path, lines)
    grid = _validate({"name": path.stem, **mapping, **overrides}, str(path), lines)
    files = {f"profile {name}": str(path.parent / name) for name in sorted(set(_file_names(grid)))}
    return grid, path.parent, {"grid": str(path), **files}


def _network(source: str) -> dict[str, Any]:
    if not source.startswith(PANDAPOWER):
        raise InvalidConfig(f"network: {source!r}; pandapower:NAME expected, such as pandapower:cigre_lv")
    from zenostat.plants.grid.pandapower import read_network  # an extra of its own

    return read_network(source.removeprefix(PANDAPOWER))


def _merge(network: dict[str, Any], mapping: Mapping[str, Any], path: Path, lines: Lines) -> dict[str, Any]:
    """Return a network with what a file adds to it."""
    merged = dict(network)
    for name, value in mapping.items():
        present = merged.get(name)
        if isinstance(present, dict) and isinstance(value, dict) and name != "source":
            if twice := sorted(present.keys() & value.keys()):
                line = lines.at((name, twice[0]))
                raise InvalidConfig(f"{path}:{line}: {name}: the network has {', '.join(map(str, twice))} already")
            merged[name] = {**present, **value}
        else:
            merged[name] = value
    return merged


def _validate(mapping: Mapping[str, Any], what: str, lines: Lines) -> Grid:
    """Validate a grid; each error has the line of what is wrong, if the file has it."""
    try:
        return Grid.model_validate(mapping)
    except ValidationError as error:
        texts = [(_line(location, lines), text) for location, text in _errors(error)]
    ordered = [f"{what}:{line}: {text}" if line else f"{what}: {text}" for line, text in sorted(texts)]
    raise InvalidConfig(ordered[0] if len(ordered) == 1 else list_errors(f"{what} has errors:", ordered))


def _errors(error: ValidationError) -> Iterator[tuple[Sequence[str | int], str]]:
    """Yield the place and the text of each error; those of rules on several parts begin with the place of one."""
    for detail, (location, text) in zip(error.errors(include_url=False), located_errors(error, Grid), strict=True):
        rules = detail.get("ctx", {}).get("errors")
        if rules is None:
            yield location, text
        for rule in rules or ():
            yield rule.partition(":")[0].split("."), rule


def _line(location: Sequence[str | int], lines: Lines) -> int:
    """Return the line of a value, or of the nearest one around it; 0 if the file has none of them."""
    return lines.at(location) if tuple(location[:1]) in lines else 0


def _file_names(grid: Grid) -> Iterator[str]:
    powers = [*(load.power_w for load in grid.loads.values()), *(pv.power_w for pv in grid.pv.values())]
    yield from (power.file for power in powers if isinstance(power, Profile))
    if grid.price is not None and isinstance(grid.price.price, Profile):
        yield grid.price.price.file
    for charger in grid.chargers.values():
        if isinstance(charger.sessions, SessionFile):
            yield charger.sessions.file
