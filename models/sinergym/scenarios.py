"""Scenarios from a configuration file of Sinergym, and those of the data pack `sinergym`. No code of either is run.

The form is that of Sinergym 3.12. What its files say in Python text is read by `models.sinergym.literals`; the choices
of its discrete scenarios stand in its code, and are read from the syntax tree of that.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from models import data_packs
from models.scenario.schema import Scenario, load_yaml
from models.sinergym.config import PACK, Reader, SinergymConfig
from models.sinergym.literals import Table, literal, table, text_of, tree
from topics.errors import InvalidConfig, UnknownName, did_you_mean
from topics.scenario_ids import DEMO, DISCRETE, pack_ids, variants

_TABLE = ("DEFAULT_", "_DISCRETE_FUNCTION")
_EPLUS = "Eplus-"
_REGISTRATION = re.compile(r"^register\(\n.*?^\)$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True)
class Configuration:
    """What a file describes: scenarios by id, the ids of those without a table of choices, and why they have none."""

    scenarios: dict[str, Scenario]
    unsupported: tuple[str, ...]
    reason: str


def scenarios_of(config: Path, *, discrete_tables: Mapping[str, Table] | None = None) -> dict[str, Scenario]:
    """The scenarios of a Sinergym configuration file, by id (without `Eplus-`), in Sinergym's order.

    Args:
        config: the YAML file. Buildings and weather are files beside it, absolute paths, or files of the data pack.
        discrete_tables: what discrete choices mean, by id base; None is what the data pack knows. Discrete
            scenarios without a table are left out; `scenario_of` says why.

    Raises:
        UnknownName: there is no such file.
        InvalidConfig: with all faults of the file; or there are only discrete scenarios, and no table for them.
    """
    found = read(config, discrete_tables=discrete_tables)
    if not found.scenarios:
        raise InvalidConfig(found.reason)
    return found.scenarios


def scenario_of(
    config: Path,
    wanted: str | None = None,
    *,
    discrete_tables: Mapping[str, Table] | None = None,
    overridden: Collection[str] = (),
) -> Scenario:
    """One scenario of a Sinergym configuration file.

    Args:
        config: as in `scenarios_of`.
        wanted: an id (`Eplus-` may stand before it), or the end of one that fits only one, as `hot-discrete`;
            None is the first.
        discrete_tables: as in `scenarios_of`.
        overridden: arguments (see `models.sinergym.config.OVERRIDDEN_BY`) that replace fields of the file; errors in
            those fields do not matter.

    Raises:
        UnknownName: none or several fit.
        InvalidConfig: as in `scenarios_of`, or the one that is wanted is discrete and there is no table for it.
    """
    found = read(config, discrete_tables=discrete_tables, overridden=overridden)
    ids = [*found.scenarios, *found.unsupported]
    name = (wanted or ids[0]).removeprefix(_EPLUS)
    end = f"-{name.removesuffix('-v1')}-v1"
    fits = [i for i in ids if i == name] or [i for i in ids if i.endswith(end)]
    if len(fits) > 1:
        raise UnknownName(f"{config}: {wanted!r} matches several: {', '.join(fits)}")
    if not fits:
        raise UnknownName(f"{config} has no scenario {wanted!r}; {did_you_mean(name, ids)}")
    if fits[0] in found.unsupported:
        raise InvalidConfig(found.reason)
    return found.scenarios[fits[0]]


def kept_episodes(config: Path) -> int | None:
    """Of how many episodes a configuration keeps files (`max_ep_store`); None where it says nothing."""
    return Reader(load_yaml(config), config, {}).kept_episodes()


def read(
    config: Path, *, discrete_tables: Mapping[str, Table] | None = None, overridden: Collection[str] = ()
) -> Configuration:
    """All that a Sinergym configuration file describes; raises as `scenarios_of` does for its faults."""
    tables = _tables_of_pack() if discrete_tables is None else discrete_tables
    return _variants(Reader(load_yaml(config), config, tables, overridden).read(), config)


def _variants(parsed: SinergymConfig, path: Path) -> Configuration:
    """Each weather in each form, without and with noise."""
    found, lacking = {}, []
    for key, weather in parsed.weathers.items():
        for name in variants(parsed.base, key, parsed.forms):
            noisy = name.endswith("-stochastic-v1")
            discrete = f"-{DISCRETE}" in name.removeprefix(f"{parsed.base}-{key}")
            if noisy and not parsed.noise:
                continue
            if discrete and parsed.choices is None:
                lacking.append(name)
                continue
            about = f"Sinergym's {parsed.base} in the weather {key!r}"
            about += (", discrete" if discrete else "") + (", weather with noise" if noisy else "")
            update: dict[str, Any] = {"id": name, "about": about, "weather": weather}
            update |= {"discrete": parsed.choices} if discrete else {}
            update |= {"weather_noise": parsed.noise} if noisy else {}
            found[name] = parsed.scenario.model_copy(update=update)
    return Configuration(found, tuple(lacking), f"{path}: {parsed.reason}")


def discrete_tables(constants: Path) -> dict[str, Table]:
    """What the discrete choices of a `constants.py` of Sinergym mean, by id base in lower case.

    Raises:
        UnknownName: there is no such file.
        InvalidConfig: such a function does more than name numbers.
    """
    begin, end = _TABLE
    return {
        node.name.removeprefix(begin).removesuffix(end).lower(): table(node)
        for node in tree(text_of(constants), str(constants)).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith(begin) and node.name.endswith(end)
    }


def _tables_of_pack() -> dict[str, Table]:
    return _tables_in(data_packs.root(PACK)) if data_packs.is_installed(PACK) else {}


@cache
def _tables_in(root: Path) -> dict[str, Table]:
    return discrete_tables(root / "utils" / "constants.py")


def pack_scenarios() -> dict[str, Scenario]:
    """The scenarios of the data pack `sinergym` by id, in the order of `topics.scenario_ids.pack_ids`.

    Raises:
        InvalidConfig: the pack was not added yet; the text has the command.
    """
    return dict(_scenarios_in(data_packs.root(PACK)))


@cache
def _scenarios_in(root: Path) -> dict[str, Scenario]:
    found = {DEMO: demo(root / "__init__.py")}
    for config in sorted((root / "data" / "default_configuration").glob("*.yaml")):
        found |= scenarios_of(config, discrete_tables=_tables_in(root))
    ranks = {name: rank for rank, name in enumerate(pack_ids())}
    return dict(sorted(found.items(), key=lambda item: ranks.get(item[0], len(ranks))))


def demo(init: Path) -> Scenario:
    """The scenario that Sinergym's `__init__.py` registers in its code.

    Raises:
        InvalidConfig: there is no such literal registration.
    """
    # Statement by statement: the rest of the file has f-strings that Python 3.11 cannot parse.
    for found in _REGISTRATION.finditer(text_of(init)):
        for node in tree(found[0], str(init)).body:
            call = node.value if isinstance(node, ast.Expr) else None
            said = {k.arg: k.value for k in call.keywords} if isinstance(call, ast.Call) else {}
            given = said.get("kwargs")
            if "id" in said and literal(said["id"]) == _EPLUS + DEMO and isinstance(given, ast.Dict):
                return _registered(given, init)
    raise InvalidConfig(f"{init} registers no {_EPLUS + DEMO}")


def _registered(given: ast.Dict, init: Path) -> Scenario:
    """A registration's arguments, put into the form of a file."""
    said: dict[str, Any] = {}
    for key, value in zip(given.keys, given.values, strict=True):
        name = literal(key) if key is not None else ""
        if name == "reward" and isinstance(value, ast.Call) and len(value.args) == 1:
            said[name] = literal(value.args[0])  # import_from_path("module:class"): the text is enough
        else:
            said[name] = ast.unparse(value) if name == "action_space" else literal(value)
    variables: dict[str, dict[str, list[str]]] = {}
    for name, (variable, key_name) in said.pop("variables").items():
        spec = variables.setdefault(variable, {"variable_names": [], "keys": []})
        spec["variable_names"].append(name)
        spec["keys"].append(key_name)
    said["variables"] = variables
    said["meters"] = {meter: name for name, meter in said["meters"].items()}
    said["actuators"] = {
        key_name: {"variable_name": name, "element_type": kind, "value_type": value}
        for name, (kind, value, key_name) in said["actuators"].items()
    }
    said.pop("env_name")
    said["weather_specification"] = {"weather_files": [said.pop("weather_files")], "keys": ["demo"]}
    found = Reader(said | {"id_base": "demo"}, init, {}).read()
    about = "the five-zone building from January to March, hour by hour"
    return found.scenario.model_copy(update={"id": DEMO, "about": about})
