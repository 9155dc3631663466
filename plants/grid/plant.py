"""An electric grid as the class of a plant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from zenostat.plants.grid.devices import BatteryState, ChargerState
from zenostat.plants.grid.file import read_grid
from zenostat.plants.grid.network import DivergedPowerFlow, Network, PowerFlow, reactive_ratio
from zenostat.plants.grid.profiles import Means
from zenostat.plants.grid.schema import Load, OnDivergence, Price
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import PlantFailed

_METERS = {"electricity": ("J", 0.0, None), "electricity_exported": ("J", 0.0, None), "losses_energy": ("J", 0.0, None)}
_SOURCE = ("import", "export", "losses")
"""Sensors of powers, in the order of the meters."""


class GridPlant:
    """An electric grid with loads, PV, batteries and chargers, see docs/grid.md.

    A timestep is one power flow of the mean powers over it.

    Args:
        file: YAML file, or `pandapower:NAME`.
        step_s, duration_s, begin: in place of those of the file.

    Raises:
        InvalidConfig: the file is not valid, or power-grid-model is not installed; lists all errors.
    """

    forkable = True
    meters = _METERS

    def __init__(
        self, file: str, step_s: float | None = None, duration_s: float | None = None, begin: str | None = None
    ) -> None:
        overrides = {"step_s": step_s, "duration_s": duration_s, "begin": begin}
        self.grid, folder, self.files = read_grid(file, {k: v for k, v in overrides.items() if v is not None})
        grid = self.grid
        self.model_name = grid.name
        self.step_s, self.duration_s, self.begin = grid.step_s, grid.duration_s, grid.begin
        self._loads = {name: Means.read(load.power_w, folder) for name, load in grid.loads.items()}
        self._pv = {name: Means.read(pv.power_w, folder, low=0.0) for name, pv in grid.pv.items()}
        self._price = Means.read(grid.price.price, folder) if grid.price is not None else None
        self._batteries = {name: BatteryState(battery) for name, battery in grid.batteries.items()}
        times = grid.begin, grid.duration_s
        self._chargers = {n: ChargerState(n, part, folder, *times) for n, part in grid.chargers.items()}
        connected = (grid.loads, grid.pv, grid.batteries, grid.chargers)
        self._network = Network(grid, {name: part.bus for parts in connected for name, part in parts.items()})
        self.sensors = self._sensors()
        self.diagram = self._diagram()
        self.actuators = self._actuators()
        self.actions = [f"{n}_setpoint" for n in grid.batteries] + [f"{n}_limit" for n in grid.chargers]
        self.actions += [f"{name}_curtailment" for name in grid.pv]
        self.actions = self.actions or list(self.actuators)
        self._steps = 0
        self._good: dict[str, float] = {}
        self._texts: list[str] = []

    def _diagram(self) -> dict[str, Any]:
        """Return buses, branches and what is connected, as fields of `zenostat.topics.messages.ElectricGrid`."""
        grid = self.grid
        devices: dict[str, Mapping[str, Any]] = {
            "load": grid.loads,
            "pv": grid.pv,
            "battery": grid.batteries,
            "charger": grid.chargers,
        }
        branches: dict[str, Mapping[str, Any]] = {"transformer": grid.transformers, "line": grid.lines}
        return {
            "source": grid.source.bus,
            "buses": list(grid.buses),
            "branches": [
                {"name": name, "kind": kind, "start": part.start, "end": part.end}
                for kind, parts in branches.items()
                for name, part in parts.items()
            ],
            "devices": [
                {"name": name, "kind": kind, "bus": part.bus}
                for kind, parts in devices.items()
                for name, part in parts.items()
            ],
        }

    def _sensors(self) -> dict[str, tuple[str | float | None, ...]]:
        grid, free = self.grid, (None, None)
        sensors: dict[str, tuple[str | float | None, ...]] = {}
        sensors |= {f"{name}_voltage": ("pu", 0.0, None, "mean") for name in grid.buses}
        sensors |= {f"{name}_loading": ("percent", 0.0, None, "mean") for name in (*grid.lines, *grid.transformers)}
        sensors |= dict.fromkeys(_SOURCE[:2], ("W", 0.0, None, "mean"))
        powers = (*grid.loads, *grid.pv, *grid.batteries, *grid.chargers)
        sensors |= dict.fromkeys(("losses", *(f"{name}_power" for name in powers)), ("W", *free, "mean"))
        sensors |= {f"{name}_available": ("W", 0.0, None) for name in grid.pv}
        sensors |= {f"{name}_state_of_charge": ("fraction", 0.0, 1.0) for name in grid.batteries}
        for name in grid.chargers:
            sensors |= {f"{name}_connected": ("on_off", 0.0, 1.0), f"{name}_needed": ("J", 0.0, None)}
            sensors |= {f"{name}_departure": ("s", 0.0, None), f"{name}_unmet": ("J", 0.0, None)}
        if isinstance(grid.price, Price):
            sensors["price"] = (grid.price.unit, *free)
        return {**sensors, "converged": ("on_off", 0.0, 1.0)}

    def _actuators(self) -> dict[str, tuple[Any, ...]]:
        """Return the actuators; nobody need command a load, which then has its profile."""
        grid = self.grid
        actuators: dict[str, tuple[Any, ...]] = {}
        actuators |= {f"{name}_demand": ("W", load.low_w, load.high_w) for name, load in grid.loads.items()}
        actuators |= {f"{name}_curtailment": ("fraction", 0.0, 1.0, 0.0) for name in grid.pv}
        for name, battery in grid.batteries.items():
            limit_w = battery.power_kw * 1e3
            actuators[f"{name}_setpoint"] = ("W", -limit_w, limit_w, 0.0)
        for name, charger in grid.chargers.items():
            actuators[f"{name}_limit"] = ("W", 0.0, charger.power_kw * 1e3, charger.power_kw * 1e3)
        return actuators

    def reset(self, seed: int) -> dict[str, float]:
        """Begin an episode; sample 0 has the powers of the first timestep, without batteries and chargers."""
        self._steps, self._texts = 0, []
        for number, charger in enumerate(self._chargers.values()):
            charger.reset(np.random.default_rng([seed, number]))
        for battery in self._batteries.values():
            battery.reset()
        powers = self._powers({}, 0.0, self.step_s) | dict.fromkeys((*self._batteries, *self._chargers), 0.0)
        try:
            self._good = self._electrical(self._network.solve(*self._injections(powers)), powers)
        except DivergedPowerFlow as error:
            raise PlantFailed(
                f"grid {self.model_name}: the power flow of sample 0 does not converge; {error}"
            ) from None
        return {**self._good, **self._states(), **dict.fromkeys(_METERS, 0.0), "converged": 1.0}

    def step(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Simulate a timestep: the power flow of its mean powers.

        Raises:
            PlantFailed: it does not converge, and the policy of the file is `stop`.
        """
        begin_s = self._steps * self.step_s
        end_s = begin_s + self.step_s
        energies = {
            name: charger.energies(commands.get(f"{name}_limit", np.inf), begin_s, end_s)
            for name, charger in self._chargers.items()
        }
        powers = self._powers(commands, begin_s, end_s)
        powers |= {name: sum(parts.values()) / self.step_s for name, parts in energies.items()}
        self._steps += 1
        try:
            flow = self._network.solve(*self._injections(powers))
        except DivergedPowerFlow as error:
            return self._keep(error)
        for name, battery in self._batteries.items():
            battery.store(powers[name], self.step_s)
        for name, charger in self._chargers.items():
            charger.charge(energies[name], end_s)
        self._good = self._electrical(flow, powers)
        return {**self._good, **self._states(), **self._metered(), "converged": 1.0}

    def _keep(self, error: DivergedPowerFlow) -> dict[str, float]:
        """Keep the last good voltages and loadings, in a timestep in which no power flows; or fail."""
        text = f"the power flow of step {self._steps} does not converge; {error}"
        if self.grid.on_divergence is OnDivergence.STOP:
            raise PlantFailed(f"grid {self.model_name}: {text}")
        self._texts.append(f"{text}; the last good voltages are kept, and no power flows")
        for charger in self._chargers.values():
            charger.charge({}, self._steps * self.step_s)
        nothing = {name: 0.0 for name in self._good if name in _SOURCE or name.endswith("_power")}
        return {**self._good, **nothing, **self._states(), **dict.fromkeys(_METERS, 0.0), "converged": 0.0}

    def _powers(self, commands: Mapping[str, float], begin_s: float, end_s: float) -> dict[str, float]:
        """Return the mean power that each load, PV system and battery draws, W."""
        powers: dict[str, float] = {}
        for name, load in self._loads.items():
            command = commands.get(f"{name}_demand")
            powers[name] = load.mean(begin_s, end_s) if command is None else command
        for name, pv in self._pv.items():
            powers[name] = -pv.mean(begin_s, end_s) * (1.0 - commands.get(f"{name}_curtailment", 0.0))
        for name, battery in self._batteries.items():
            powers[name] = battery.power(commands.get(f"{name}_setpoint", 0.0), end_s - begin_s)
        return powers

    def _injections(self, powers: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Return active and reactive power, in the order of the network."""
        grid = self.grid
        names = (*grid.loads, *grid.pv, *grid.batteries, *grid.chargers)
        reactive = [_reactive_var(grid.loads[name], powers[name]) if name in grid.loads else 0.0 for name in names]
        return np.array([powers[name] for name in names]), np.array(reactive)

    def _electrical(self, flow: PowerFlow, powers: Mapping[str, float]) -> dict[str, float]:
        """Return the sensors of the power flow; PV has a positive power."""
        grid = self.grid
        values = {f"{bus}_voltage": float(v) for bus, v in zip(grid.buses, flow.voltages_pu, strict=True)}
        loadings = (*flow.line_loadings, *flow.transformer_loadings)
        names = (*grid.lines, *grid.transformers)
        values |= {f"{name}_loading": float(loading) for name, loading in zip(names, loadings, strict=True)}
        values |= {"import": max(flow.source_w, 0.0), "export": max(-flow.source_w, 0.0), "losses": flow.losses_w}
        return values | {f"{n}_power": (-power if n in grid.pv else power) + 0.0 for n, power in powers.items()}

    def _metered(self) -> dict[str, float]:
        """Return the energies of a timestep, J."""
        return {meter: self._good[name] * self.step_s for meter, name in zip(_METERS, _SOURCE, strict=True)}

    def _states(self) -> dict[str, float]:
        """Return what is known at the end of a timestep, and the price and the available power of the next one."""
        time_s = self._steps * self.step_s
        next_s = time_s + self.step_s
        values = {f"{name}_state_of_charge": battery.state_of_charge for name, battery in self._batteries.items()}
        values |= {f"{name}_available": pv.mean(time_s, next_s) for name, pv in self._pv.items()}
        for name, charger in self._chargers.items():
            stay = charger.connected(time_s)
            values[f"{name}_connected"] = float(stay is not None)
            values[f"{name}_needed"] = 0.0 if stay is None else charger.needs_j[stay]
            values[f"{name}_departure"] = 0.0 if stay is None else charger.stays[stay].departure_s - time_s
            values[f"{name}_unmet"] = charger.unmet_j
        if self._price is not None:
            values["price"] = self._price.mean(time_s, next_s)
        return values

    def drain_warnings(self) -> list[str]:
        """Return the power flows that did not converge since the last call."""
        texts, self._texts = self._texts, []
        return texts

    def save(self) -> dict[str, Any]:
        """Return all that the next timesteps depend on."""
        chargers = {n: (c.stays, list(c.needs_j), c.unmet_j) for n, c in self._chargers.items()}
        batteries = {name: battery.energy_j for name, battery in self._batteries.items()}
        return {"steps": self._steps, "good": dict(self._good), "batteries": batteries, "chargers": chargers}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a state that `save` returned."""
        self._steps, self._good = state["steps"], dict(state["good"])
        for name, energy_j in state["batteries"].items():
            self._batteries[name].energy_j = energy_j
        for name, (stays, needs_j, unmet_j) in state["chargers"].items():
            charger = self._chargers[name]
            charger.stays, charger.needs_j, charger.unmet_j = stays, list(needs_j), unmet_j


def _reactive_var(load: Load, power_w: float) -> float:
    return load.reactive_var if load.reactive_var is not None else power_w * reactive_ratio(load.power_factor)
