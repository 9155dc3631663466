"""Read scenarios from Sinergym's configuration files and from the data pack `sinergym`, without running their code.

The format is that of Sinergym 3.12. Python expressions in its files are read by `zenostat.models.sinergym.literals`;
the choices of its discrete scenarios are defined in its code and are read from the syntax tree.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from zenostat.models import data_packs
from zenostat.models.scenario.schema import Scenario, load_yaml
from zenostat.models.sinergym.config import PACK, Reader, SinergymConfig
from zenostat.models.sinergym.literals import Table, parse, read_literal, read_table, text_of
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.scenario_ids import DEMO, DISCRETE, pack_ids, variants

_TABLE = ("DEFAULT_", "_DISCRETE_FUNCTION")
_EPLUS = "Eplus-"
_REGISTRATION = re.compile(r"^register\(\n.*?^\)$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A configuration file: scenarios by id, ids of those with unknown choices, and why these are unknown."""

    scenarios: dict[str, Scenario]
    unsupported: tuple[str, ...]
    reason: str


def scenarios_of(config: Path, *, discrete_tables: Mapping[str, Table] | None = None) -> dict[str, Scenario]:
    """Return the scenarios of a Sinergym configuration file, by id (without `Eplus-`), in Sinergym's order.

    Args:
        config: the YAML file. Buildings and weather are files next to it, absolute paths, or files of the data pack.
        discrete_tables: the meaning of discrete choices, by id base; None uses the data pack's. Discrete scenarios
            without a table are left out; `scenario_of` raises an error with the reason.

    Raises:
        UnknownName: there is no such file.
        InvalidConfig: lists all errors of the file; or there are only discrete scenarios, and no table for them.
    """
    configuration = read(config, discrete_tables=discrete_tables)
    if not configuration.scenarios:
        raise InvalidConfig(configuration.reason)
    return configuration.scenarios


def scenario_of(
    config: Path,
    wanted: str | None = None,
    *,
    discrete_tables: Mapping[str, Table] | None = None,
    overridden: Collection[str] = (),
) -> Scenario:
    """Return one scenario of a Sinergym configuration file.

    Args:
        config: as in `scenarios_of`.
        wanted: an id, with or without the prefix `Eplus-`, or a suffix that only one id has, as `hot-discrete`; None
            selects the first scenario.
        discrete_tables: as in `scenarios_of`.
        overridden: arguments (see `zenostat.models.sinergym.config.OVERRIDDEN_BY`) that replace settings of the file;
            errors in those settings are ignored.

    Raises:
        UnknownName: no scenario matches, or several do.
        InvalidConfig: as in `scenarios_of`, or the scenario is discrete and there is no table for it.
    """
    configuration = read(config, discrete_tables=discrete_tables, overridden=overridden)
    ids = [*configuration.scenarios, *configuration.unsupported]
    name = (wanted or ids[0]).removeprefix(_EPLUS)
    suffix = f"-{name.removesuffix('-v1')}-v1"
    matches = [i for i in ids if i == name] or [i for i in ids if i.endswith(suffix)]
    if len(matches) > 1:
        raise UnknownName(f"{config}: {wanted!r} matches several: {', '.join(matches)}")
    if not matches:
        raise UnknownName(f"{config} has no scenario {wanted!r}; {did_you_mean(name, ids)}")
    if matches[0] in configuration.unsupported:
        raise InvalidConfig(configuration.reason)
    return configuration.scenarios[matches[0]]


def kept_episodes(config: Path) -> int | None:
    """Return the number of episodes of which a configuration keeps files (`max_ep_store`); None if it is not set."""
    return Reader(load_yaml(config), config, {}).kept_episodes()


def read(
    config: Path, *, discrete_tables: Mapping[str, Table] | None = None, overridden: Collection[str] = ()
) -> Configuration:
    """Read a Sinergym configuration file; raises the errors of `scenarios_of`."""
    tables = _tables_of_pack() if discrete_tables is None else discrete_tables
    return _variants(Reader(load_yaml(config), config, tables, overridden).read(), config)


def _variants(parsed: SinergymConfig, path: Path) -> Configuration:
    """Combine each weather with each form, without and with noise."""
    scenarios, unsupported = {}, []
    for key, weather in parsed.weathers.items():
        for name in variants(parsed.base, key, parsed.forms):
            noisy = name.endswith("-stochastic-v1")
            discrete = f"-{DISCRETE}" in name.removeprefix(f"{parsed.base}-{key}")
            if noisy and not parsed.noise:
                continue
            if discrete and parsed.choices is None:
                unsupported.append(name)
                continue
            about = f"Sinergym's {parsed.base} in the weather {key!r}"
            about += (", discrete" if discrete else "") + (", weather with noise" if noisy else "")
            update: dict[str, Any] = {"id": name, "about": about, "weather": weather}
            update |= {"discrete": parsed.choices} if discrete else {}
            update |= {"weather_noise": parsed.noise} if noisy else {}
            scenarios[name] = parsed.scenario.model_copy(update=update)
    return Configuration(scenarios, tuple(unsupported), f"{path}: {parsed.reason}")


def discrete_tables(constants: Path) -> dict[str, Table]:
    """Return the tables of discrete choices in Sinergym's `constants.py`, by id base in lower case.

    Raises:
        UnknownName: there is no such file.
        InvalidConfig: a function of a table is not a plain table.
    """
    begin, end = _TABLE
    return {
        node.name.removeprefix(begin).removesuffix(end).lower(): read_table(node)
        for node in parse(text_of(constants), str(constants)).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith(begin) and node.name.endswith(end)
    }


def _tables_of_pack() -> dict[str, Table]:
    return _tables_in(data_packs.root(PACK)) if data_packs.is_installed(PACK) else {}


@cache
def _tables_in(root: Path) -> dict[str, Table]:
    return discrete_tables(root / "utils" / "constants.py")


def pack_scenarios() -> dict[str, Scenario]:
    """Return the scenarios of the data pack `sinergym` by id, in the order of `zenostat.topics.scenario_ids.pack_ids`.

    Raises:
        InvalidConfig: the pack has not been added; the text has the command.
    """
    return dict(_scenarios_in(data_packs.root(PACK)))


@cache
def _scenarios_in(root: Path) -> dict[str, Scenario]:
    scenarios = {DEMO: demo(root / "__init__.py")}
    for config in sorted((root / "data" / "default_configuration").glob("*.yaml")):
        scenarios |= scenarios_of(config, discrete_tables=_tables_in(root))
    ranks = {name: rank for rank, name in enumerate(pack_ids())}
    return dict(sorted(scenarios.items(), key=lambda item: ranks.get(item[0], len(ranks))))


def demo(init: Path) -> Scenario:
    """Return the scenario that Sinergym registers in its `__init__.py`.

    Raises:
        InvalidConfig: the file has no such registration, or it is not a literal.
    """
    # Only the registrations: the rest of the file has f-strings that Python 3.11 cannot parse.
    for match in _REGISTRATION.finditer(text_of(init)):
        for node in parse(match[0], str(init)).body:
            call = node.value if isinstance(node, ast.Expr) else None
            keywords = {k.arg: k.value for k in call.keywords} if isinstance(call, ast.Call) else {}
            arguments = keywords.get("kwargs")
            if "id" in keywords and read_literal(keywords["id"]) == _EPLUS + DEMO and isinstance(arguments, ast.Dict):
                return _read_registration(arguments, init)
    raise InvalidConfig(f"{init} registers no {_EPLUS + DEMO}")


def _read_registration(arguments: ast.Dict, init: Path) -> Scenario:
    """Convert a registration's arguments to the format of a file, and read that."""
    settings: dict[str, Any] = {}
    for key, value in zip(arguments.keys, arguments.values, strict=True):
        name = read_literal(key) if key is not None else ""
        if name == "reward" and isinstance(value, ast.Call) and len(value.args) == 1:
            settings[name] = read_literal(value.args[0])  # import_from_path("module:class"): the text is enough
        else:
            settings[name] = ast.unparse(value) if name == "action_space" else read_literal(value)
    variables: dict[str, dict[str, list[str]]] = {}
    for name, (variable, key_name) in settings.pop("variables").items():
        spec = variables.setdefault(variable, {"variable_names": [], "keys": []})
        spec["variable_names"].append(name)
        spec["keys"].append(key_name)
    settings["variables"] = variables
    settings["meters"] = {meter: name for name, meter in settings["meters"].items()}
    settings["actuators"] = {
        key_name: {"variable_name": name, "element_type": kind, "value_type": value}
        for name, (kind, value, key_name) in settings["actuators"].items()
    }
    settings.pop("env_name")
    settings["weather_specification"] = {"weather_files": [settings.pop("weather_files")], "keys": ["demo"]}
    config = Reader(settings | {"id_base": "demo"}, init, {}).read()
    about = "the five-zone building from January to March, in hourly steps"
    return config.scenario.model_copy(update={"id": DEMO, "about": about})
