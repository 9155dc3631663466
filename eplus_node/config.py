"""The settings of a node, and the scenario that they name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from zenostat.bridge.node.settings import NodeSettings
from zenostat.models.scenario.registry import find_scenario
from zenostat.models.scenario.schema import Scenario, load_scenario, read_scenario
from zenostat.topics.codec import validated
from zenostat.topics.errors import ErrorCollector, InvalidConfig, did_you_mean


class NodeConfig(NodeSettings):
    """Settings of a node that simulates a building; those of an environment are in `zenostat.topics.scenario_fields`.

    Attributes:
        scenario_fields: fields of a scenario; they override those of `scenario`.
        shrink_caches: on by default because of its gain; see `zenostat.eplus_node.engine.memory`.
        keep_last: None keeps all, or as many as the Sinergym configuration defines.
    """

    scenario: str | None = None
    config: Path | None = None
    variant: str | None = None
    scenario_fields: dict[str, Any] = Field(default_factory=dict)
    shrink_caches: bool = True
    output_dir: Path | None = None
    keep_last: Annotated[int, Field(ge=1)] | None = None


def read_config(settings: Mapping[str, Any]) -> NodeConfig:
    """Validate settings, which contain the fields of the node and of the scenario side by side.

    Raises:
        InvalidConfig: lists all errors.
    """
    node_fields = {name: value for name, value in settings.items() if name in NodeConfig.model_fields}
    scenario_fields = {name: value for name, value in settings.items() if name in Scenario.model_fields}
    known = [*NodeConfig.model_fields, *Scenario.model_fields]
    unknown = [f"no setting {name!r}; {did_you_mean(name, known)}" for name in settings if name not in known]
    if unknown:
        raise InvalidConfig("\n".join(unknown))
    if settings.get("keep_last") is not None and settings.get("output_dir") is None:
        raise InvalidConfig("keep_last needs output_dir, the folder in which output files are kept")
    if settings.get("variant") is not None and settings.get("config") is None:
        raise InvalidConfig("variant needs config, the Sinergym configuration that it is a variant of")
    return validated(NodeConfig, {"scenario_fields": scenario_fields, **node_fields})


def kept_episodes(config: NodeConfig) -> int | None:
    """Return the number of episodes before the running one whose files are kept; None keeps all."""
    if config.keep_last is not None or config.config is None or config.output_dir is None:
        return config.keep_last
    from zenostat.models.sinergym.scenarios import kept_episodes as sinergym_kept_episodes

    return sinergym_kept_episodes(config.config)


def read_base(config: NodeConfig, errors: ErrorCollector | None = None) -> Scenario | None:
    """Return the scenario that the settings name, or None. `errors`: as in `read_scenario`."""
    if config.config is not None:
        from zenostat.models.sinergym.scenarios import (
            scenario_of as sinergym_scenario,
        )  # rarely needed, and slow to import

        overridden = {name for name, value in config.scenario_fields.items() if value is not None}
        overridden |= set() if config.environment_reward == "scenario" else {"reward"}
        overridden |= {"period"} if {"begin", "end"} <= overridden else set()
        return sinergym_scenario(config.config, config.variant, overridden=overridden)
    if config.scenario is None:
        return None
    path = Path(config.scenario).expanduser()
    return load_scenario(path, errors) if path.suffix in (".yaml", ".yml") else find_scenario(config.scenario)


def scenario_of(config: NodeConfig, errors: ErrorCollector | None = None) -> Scenario:
    """Return the scenario with the fields that the settings override. `errors`: as in `read_scenario`.

    Raises:
        UnknownName, InvalidConfig: no such scenario, or invalid fields.
    """
    base = read_base(config, errors)
    overrides = {name: value for name, value in config.scenario_fields.items() if value is not None}
    if base is None:
        missing = [name for name in ("building", "weather") if name not in overrides]
        if missing:
            raise InvalidConfig(f"name a scenario, or a building and a weather ({' and '.join(missing)} missing)")
        return read_scenario(overrides, "the settings", errors)
    if not overrides:
        return base
    changed = {"actuators", "actions", "control", "building"} & set(overrides)
    fields = base.model_dump(exclude_unset=True)
    if changed:  # fields that refer to actuators of the base are invalid for others
        stale = {"actions", "discrete"} | (
            {"sensors", "meters", "actuators", "unobserved"} if "building" in changed else set()
        )
        fields = {name: value for name, value in fields.items() if name not in stale or isinstance(value, int)}
    return read_scenario(fields | overrides, "the settings", errors)
