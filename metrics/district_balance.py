"""Energy balances of the plants of a district, by carrier, and the parts of its trajectory that belong to a plant.

The energies are integrals over the trajectory of the points that bundled plants measure. A grid has the balance

    import + generation = loads + vehicles + export + losses + charging of the batteries

and a heat network that of `zenostat.plants.heat`: source = deliveries + losses of tank and pipes + charging of the
tank. Of other plants, such as buildings, only the consumption is known.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import fsum

import numpy as np

from zenostat.metrics.roles import roles
from zenostat.metrics.trajectory import Trajectory
from zenostat.topics.arrays import Floats
from zenostat.topics.connection_balance import TERMS, ConnectionBalance
from zenostat.topics.messages import Manifest, Meter, Task

_AVAILABLE = re.compile(r"plant\.([^.]+)\.available")
_GRID = {"import", "export", "losses", "converged"}
_HEAT = {"source_heat", "tank_charge", "tank_loss", "pipe_loss"}


@dataclass(frozen=True, slots=True)
class CarrierBalance:
    """Energies of a carrier in a plant, kWh; None where it is not measured.

    Attributes:
        plant: its name.
        carrier: `electricity`, `heat`, `natural gas`, ….
        supplied: what it gets, from outside and from its own generation.
        consumed: what it uses, or delivers to others.
        exported: what it feeds in.
        lost: losses.
        stored: increase of what it stores; of batteries, with their losses.
        missing_steps: number of steps in which one of the measured powers had no value, which all terms leave out.
    """

    plant: str
    carrier: str
    supplied: float | None = None
    consumed: float | None = None
    exported: float | None = None
    lost: float | None = None
    stored: float | None = None
    missing_steps: int = 0

    @property
    def label(self) -> str:
        """The carrier, with the number of steps that are left out, if any."""
        missing = self.missing_steps
        return f"{self.carrier} (steps without a value: {missing})" if missing else self.carrier

    @property
    def closure(self) -> float | None:
        """Part of the supply that is missing, 0 but for rounding; None where a term is not measured."""
        terms = (self.consumed, self.exported, self.lost, self.stored)
        known = [term for term in terms if term is not None]
        if self.supplied is None or len(known) < len(terms):
            return None
        greatest = max(abs(self.supplied), sum(map(abs, known)), 1e-12)
        return (self.supplied - sum(known)) / greatest


def connection_balances(trajectory: Trajectory) -> tuple[ConnectionBalance, ...]:
    """Return the balances of a district's connections, means over its timesteps; none for other nodes.

    Those of a nested district are among them, with its name before theirs.
    """
    columns = {sensor.name: place for place, sensor in enumerate(trajectory.manifest.sensors)}
    balances = []
    for name, place in columns.items():
        nested, _, connection = f".{name}".partition(".exchange.")
        district = f"{nested}.".removeprefix(".")
        balance = f"{district}balance.{connection}"
        terms = [term for term in TERMS if f"{balance}.{term}" in columns]
        if "sent" not in terms:
            continue
        places = [place, *(columns[f"{balance}.{term}"] for term in terms)]
        rows = trajectory.fault_free_values[1:, places]
        is_missing = np.isnan(rows).any(axis=1)
        rows = rows[~is_missing]
        if not len(rows):
            continue
        received, *means = (fsum(column.tolist()) / len(rows) for column in rows.T)
        by_term = dict.fromkeys(TERMS, 0.0) | dict(zip(terms, means, strict=True))
        greatest = fsum(np.abs(rows[:, 1 + terms.index("sent")]).tolist()) / len(rows)
        unit = trajectory.manifest.sensors[place].unit
        missing = int(is_missing.sum())
        balances.append(
            ConnectionBalance(
                district + connection, unit, received=received, greatest=greatest, missing_steps=missing, **by_term
            )
        )
    return tuple(balances)


def plant_names(manifest: Manifest) -> tuple[str, ...]:
    """Return the names of the plants of a district, in its order; none for other nodes.

    In place of a nested district are its plants, with its name before theirs: `houses.north`.
    """
    return tuple(_plants([sensor.name for sensor in manifest.sensors]))


def _plants(sensors: Sequence[str]) -> Iterator[str]:
    for match in filter(None, map(_AVAILABLE.fullmatch, sensors)):
        plant, prefix = match[1], f"{match[1]}."
        nested = [*_plants([name.removeprefix(prefix) for name in sensors if name.startswith(prefix)])]
        yield from [f"{prefix}{name}" for name in nested] or [plant]


def plant_trajectory(trajectory: Trajectory, plant: str) -> Trajectory:
    """Return the columns of a plant of a district, or of a nested one, with the names that its own node has.

    It has no reward, and no actions of an agent: those are of the district.
    """
    manifest, prefix = trajectory.manifest, f"{plant}."
    points = [place for place, name in enumerate(manifest.names) if name.startswith(prefix)]
    commanded = [place for place, each in enumerate(manifest.actuators) if each.name.startswith(prefix)]

    def own(parts: Sequence[object]) -> tuple[object, ...]:
        return tuple(
            part.model_copy(update={"name": part.name.removeprefix(prefix)})  # type: ignore[attr-defined]
            for part in parts
            if part.name.startswith(prefix)  # type: ignore[attr-defined]
        )

    parts = {"sensors": own(manifest.sensors), "meters": own(manifest.meters), "actuators": own(manifest.actuators)}
    fields = {"node": plant, "building": plant, "zones": (), "floor_area_m2": None, "task": Task(), **parts}
    return replace(
        trajectory,
        manifest=manifest.model_copy(update=fields),
        values=trajectory.values[:, points],
        fault_free_values=trajectory.fault_free_values[:, points],
        effective=trajectory.effective[:, commanded],
        source_index=trajectory.source_index[:, commanded],
        orders=None if trajectory.orders is None else trajectory.orders[:, commanded],
        baseline=None,
        baseline_effective=None,
        actions=None,
        rewards=None,
        terms={},
    )


def district_balances(trajectory: Trajectory) -> tuple[CarrierBalance, ...]:
    """Return the balances of all plants of a district, in its order; none for other nodes."""
    return tuple(
        balance
        for plant in plant_names(trajectory.manifest)
        for balance in _balances(plant, plant_trajectory(trajectory, plant))
    )


def _balances(plant: str, part: Trajectory) -> list[CarrierBalance]:
    names = set(part.manifest.names)
    if names >= _GRID:
        return [_grid(plant, part)]
    if names >= _HEAT:
        return [_heat(plant, part), *(_metered(plant, part, meter) for meter in part.manifest.meters)]
    values = part.fault_free_values[1:]
    return [
        _balance(plant, fuel.fuel, consumed=[values[:, fuel.index] * fuel.to_kw * part.step_h])
        for fuel in roles(part.manifest).fuels
    ]


def _balance(plant: str, carrier: str, **terms: Sequence[Floats]) -> CarrierBalance:
    """Return a balance whose terms are the sums of these energies of the timesteps, kWh."""
    is_missing = np.isnan([energies for term in terms.values() for energies in term]).any(axis=0)
    totals = {name: fsum(float(energies[~is_missing].sum()) for energies in term) for name, term in terms.items()}
    return CarrierBalance(plant, carrier, missing_steps=int(is_missing.sum()), **totals)


def _metered(plant: str, part: Trajectory, meter: Meter) -> CarrierBalance:
    """Return the consumption of a meter in J that has the name of its carrier."""
    joules = part.fault_free_values[1:, part.manifest.names.index(meter.name)]
    return _balance(plant, meter.name.replace("_", " "), consumed=[joules / 3.6e6])


def _reader(part: Trajectory) -> Callable[[Sequence[str]], list[Floats]]:
    """Return a function that returns powers in W as the energies of the timesteps in kWh."""
    names = part.manifest.names
    return lambda points: [part.fault_free_values[1:, names.index(name)] * part.step_h / 1e3 for name in points]


def _grid(plant: str, part: Trajectory) -> CarrierBalance:
    kwh, names = _reader(part), part.manifest.names
    devices = [name.removesuffix("_power") for name in names if name.endswith("_power")]
    batteries = [name for name in devices if f"{name}_state_of_charge" in names]
    generation = [name for name in devices if f"{name}_available" in names]
    rest = [name for name in devices if name not in (*batteries, *generation)]
    return _balance(
        plant,
        "electricity",
        supplied=kwh(["import", *(f"{name}_power" for name in generation)]),
        consumed=kwh([f"{name}_power" for name in rest]),
        exported=kwh(["export"]),
        lost=kwh(["losses"]),
        stored=kwh([f"{name}_power" for name in batteries]),
    )


def _heat(plant: str, part: Trajectory) -> CarrierBalance:
    kwh, names = _reader(part), part.manifest.names
    consumers = [name.removesuffix("_unmet") for name in names if name.endswith("_unmet")]
    return _balance(
        plant,
        "heat",
        supplied=kwh(["source_heat"]),
        consumed=kwh([f"{name}_heat" for name in consumers]),
        exported=[],
        lost=kwh(["tank_loss", "pipe_loss"]),
        stored=kwh(["tank_charge"]),
    )
