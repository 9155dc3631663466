"""Convert the actuators, the context and the action spaces of a Sinergym configuration to those of a scenario."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from zenostat.models import data_packs
from zenostat.models.scenario.schema import ActionSpec, ActuatorSpec, DiscreteActionSpec
from zenostat.models.sinergym.choices import choice_specs
from zenostat.models.sinergym.literals import BoxSpec, Space, Table, read_space
from zenostat.models.sinergym.section_reader import SectionReader
from zenostat.topics.scenario_ids import PACK_IDS


class ActionReader:
    """Reads the actions of a configuration and adds its errors to those of the configuration.

    Args:
        config: the configuration.
        tables: the meaning of discrete choices, by id base.
        overridden: arguments that replace settings of the file.
        pack: the data pack, which has the tables of its configurations.
    """

    def __init__(
        self, config: SectionReader, tables: Mapping[str, Table], overridden: Collection[str], pack: str
    ) -> None:
        self._config, self._tables, self._overridden, self._pack = config, tables, overridden, pack

    def actuators(self) -> dict[str, ActuatorSpec]:
        """Return the actuators of the action, with its bounds."""
        actuators = self._specs("actuators")
        space = self._config.settings.get("action_space")
        bounds = self._space("action_space") if space is not None else None
        if bounds is not None and not isinstance(bounds, BoxSpec):
            self._config.add_error(
                f"action_space: expected a Box, got {space!r}; a discrete one is action_space_discrete"
            )
        elif bounds is not None and len(bounds.low) != len(actuators):
            self._config.add_error(
                f"action_space has {len(bounds.low)} dimensions, but there are {len(actuators)} actuators"
            )
        elif bounds is not None:
            for (name, spec), low, high in zip(list(actuators.items()), bounds.low, bounds.high, strict=True):
                actuators[name] = spec.model_copy(update={"low": low, "high": high})
        return actuators

    def with_context(self, action_actuators: Mapping[str, ActuatorSpec]) -> dict[str, Any]:
        """Return the actuators and, if some are not part of the action, the action's dimensions."""
        context = self._specs("context")
        for name in context:
            if name in action_actuators:
                self._config.add_error(f"context: {name!r} is an actuator of the action already")
        fields: dict[str, Any] = {"actuators": {**action_actuators, **context}, **self._initial_context(list(context))}
        actions = {name: ActionSpec(actuators=(name,)) for name in action_actuators}
        return fields | ({"actions": actions} if context else {})

    def _initial_context(self, names: list[str]) -> dict[str, Any]:
        """Return a wrapper that sets the context's actuators at the beginning of an episode."""
        value = self._config.settings.get("initial_context")
        if not value or "actuators" in self._overridden:  # Sinergym treats an empty list as none
            return {}
        if not isinstance(value, list) or len(value) != len(names):
            self._config.add_error(
                f"initial_context: expected a number for each of {len(names)} actuators of context, got {value!r}"
            )
            return {}
        values = {
            name: self._config.number(n, f"initial_context.{i}")
            for i, (name, n) in enumerate(zip(names, value, strict=True))
        }
        return {"wrappers": ({"wrapper": "ChangingContext", "schedule": {"00:00": values}},)}

    def _specs(self, section: str) -> dict[str, ActuatorSpec]:
        specs: dict[str, ActuatorSpec] = {}
        names = ("variable_name", "element_type", "value_type")
        for key, spec in self._config.mapping(section).items():
            setting = f"{section}.{key}"
            if not isinstance(spec, Mapping) or not all(isinstance(spec.get(n), str) for n in names):
                self._config.add_error(f"{setting}: expected {', '.join(names)}, got {spec!r}")
                continue
            self._config.check_names(spec, names, f"{setting}: ")
            name = self._config.name(spec["variable_name"], setting)
            if name in specs:
                self._config.add_error(f"{setting}: two actuators are called {name!r}")
            elif name is not None:
                specs[name] = ActuatorSpec(
                    component_type=spec["element_type"], control_type=spec["value_type"], key=str(key)
                )
        return specs

    def _space(self, name: str) -> Space | None:
        value = self._config.settings[name]
        if not isinstance(value, str):
            self._config.add_error(f"{name}: expected a space as a string, got {value!r}")
            return None
        return self._config.collect(lambda: read_space(value), name)

    def choices(
        self, base: str, actuators: Mapping[str, ActuatorSpec]
    ) -> tuple[tuple[DiscreteActionSpec, ...] | None, str]:
        """Return the discrete dimensions of the actuators; None and the reason if their meaning is unknown."""
        value = self._config.settings.get("action_space_discrete")
        if not value or "discrete" in self._overridden or (discrete := self._space("action_space_discrete")) is None:
            return (), ""
        if isinstance(discrete, BoxSpec):
            self._config.add_error(f"action_space_discrete: expected Discrete or MultiDiscrete, got {value!r}")
            return (), ""
        table = self._tables.get(base.lower())
        if table is None:
            return None, self._unknown_choices(base)
        return self._config.collect(lambda: choice_specs(discrete, table, actuators), "action_space_discrete") or (), ""

    def _unknown_choices(self, base: str) -> str:
        if base in PACK_IDS and not data_packs.is_installed(self._pack):
            return (
                f"the meaning of the discrete choices of {base!r} is in the data pack {self._pack!r}: "
                f"{data_packs.command(self._pack)}"
            )
        value = self._config.settings["action_space_discrete"]
        return (
            f"the meaning of the choices of {value} for {base!r} is defined in code, which is not run; write "
            "them into a scenario file (its field `discrete`), or use the continuous scenarios"
        )
