"""Networks of pandapower as grids."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from math import isnan, sqrt
from typing import Any

import numpy as np

from zenostat.plants.grid.schema import bus_clocks
from zenostat.topics.errors import InvalidConfig, did_you_mean
from zenostat.topics.extras import requires_extra
from zenostat.topics.keys import safe_name

NETWORKS = {
    "case33bw": "case33bw",
    "cigre_lv": "create_cigre_network_lv",
    "cigre_mv": "create_cigre_network_mv",
    "four_loads": "four_loads_with_branches_out",
    "kerber_dorf": "create_kerber_dorfnetz",
    "kerber_landnetz_freileitung": "create_kerber_landnetz_freileitung_1",
    "kerber_landnetz_kabel": "create_kerber_landnetz_kabel_1",
    "kerber_vorstadt": "create_kerber_vorstadtnetz_kabel_1",
    "simple_four_bus": "simple_four_bus_system",
}
"""Functions of `pandapower.networks`, by the name after `pandapower:`."""
_UNUSED = ("trafo3w", "impedance", "dcline", "ward", "xward", "storage", "gen", "shunt", "motor", "svc", "tcsc", "ssc")
"""Elements that a grid does not have."""


def read_network(name: str) -> dict[str, Any]:
    """Return one of pandapower's networks as the fields of a grid's file.

    Raises:
        InvalidConfig: there is no such network, or pandapower is not installed.
    """
    if name not in NETWORKS:
        raise InvalidConfig(f"pandapower:{name}: no such network; {did_you_mean(name, list(NETWORKS))}")
    return {"name": name.replace("_", "-"), **convert(create(name))}


def create(name: str) -> Any:
    """Return one of pandapower's networks, always the same: some have lines of types that are drawn."""
    with requires_extra("pandapower", "a network of pandapower", "pandapower"):
        import pandapower.networks
    random.seed(0)
    np.random.seed(0)  # the one that pandapower draws from
    return getattr(pandapower.networks, NETWORKS[name])()


def convert(net: Any) -> dict[str, Any]:
    """Return a network of pandapower as the fields of a grid's file.

    Buses that closed switches connect become one. The T model of transformers is transformed to the pi model exactly.

    Raises:
        InvalidConfig: the network has elements that a grid does not have.
    """
    for kind in _UNUSED:
        if kind in net and len(net[kind]) and net[kind].in_service.any():
            raise InvalidConfig(f"the network has elements of pandapower's table {kind!r}, which are not supported")
    if len(net.ext_grid) != 1:
        raise InvalidConfig(f"the network has {len(net.ext_grid)} external grids; one expected")
    return _Converter(net).fields()


class BusNames:
    """Names of the buses of a network, of which closed switches make one; further names are used once.

    Args:
        net: the network.
    """

    def __init__(self, net: Any) -> None:
        self._net = net
        self._names: set[str] = set()
        self.buses = self._fused_buses()
        self.by_bus = {bus: self.add(net.bus.name[bus], f"bus_{bus}") for bus in sorted(set(self.buses.values()))}

    def add(self, text: object, default: str) -> str:
        """Return a text as a name that is not used yet."""
        base = safe_name(str(text).strip().replace(" ", "_")) if isinstance(text, str) and text.strip() else default
        name, number = base, 2
        while name in self._names:
            name, number = f"{base}_{number}", number + 1
        self._names.add(name)
        return name

    def at(self, bus: int) -> str:
        """Return the name of a bus."""
        return self.by_bus[self.buses[int(bus)]]

    def _fused_buses(self) -> dict[int, int]:
        """Return for each bus in service the one that it is fused with by closed switches."""
        net = self._net
        owner = {int(bus): int(bus) for bus in net.bus.index[net.bus.in_service]}
        for switch in net.switch.itertuples():
            if switch.et == "b" and switch.closed and {switch.bus, switch.element} <= owner.keys():
                first, second = sorted((owner[switch.bus], owner[switch.element]))
                owner = {bus: first if other == second else other for bus, other in owner.items()}
        return owner


class _Converter:
    def __init__(self, net: Any) -> None:
        self._net, self._names = net, BusNames(net)
        self._open = {(s.et, s.element, s.bus) for s in net.switch.itertuples() if s.et != "b" and not s.closed}

    def fields(self) -> dict[str, Any]:
        """Return the fields of the grid's file."""
        net = self._net
        grid = next(net.ext_grid.itertuples())
        fields = {
            "frequency_hz": round(float(net.f_hz)),
            "source": {"bus": self._names.at(grid.bus), "voltage_pu": float(grid.vm_pu)},
            "buses": {name: {"voltage_kv": float(net.bus.vn_kv[bus])} for bus, name in self._names.by_bus.items()},
            "lines": dict(self._lines()),
            "transformers": dict(self._transformers()),
            "loads": {**dict(self._loads("load", 1.0)), **dict(self._loads("sgen", -1.0))},
        }
        return _connected(fields)

    def _lines(self) -> Iterator[tuple[str, dict[str, Any]]]:
        for line in self._net.line[self._net.line.in_service].itertuples():
            if line.g_us_per_km:
                raise InvalidConfig(f"line {line.name!r} has a shunt conductance, which is not supported")
            ends = {
                end: ("l", line.Index, bus) in self._open for end, bus in (("from", line.from_bus), ("to", line.to_bus))
            }
            if all(ends.values()):
                continue
            fields = {
                "from": self._names.at(line.from_bus),
                "to": self._names.at(line.to_bus),
                "length_m": float(line.length_km) * 1e3,
                "resistance_ohm_km": float(line.r_ohm_per_km),
                "reactance_ohm_km": float(line.x_ohm_per_km),
                "capacitance_nf_km": float(line.c_nf_per_km),
                "ampacity_a": float(line.max_i_ka * line.df) * 1e3,
                "parallel": int(line.parallel),
                "open_end": next((end for end, is_open in ends.items() if is_open), None),
            }
            yield self._names.add(line.name, f"line_{line.Index}"), fields

    def _transformers(self) -> Iterator[tuple[str, dict[str, Any]]]:
        for trafo in self._net.trafo[self._net.trafo.in_service].itertuples():
            if any(("t", trafo.Index, bus) in self._open for bus in (trafo.hv_bus, trafo.lv_bus)):
                continue
            if trafo.parallel != 1 or getattr(trafo, "df", 1.0) != 1.0 or trafo.shift_degree % 30.0:
                raise InvalidConfig(
                    f"transformer {trafo.name!r}: a single one with a shift of whole 30 degrees expected"
                )
            fields = {
                "from": self._names.at(trafo.hv_bus),
                "to": self._names.at(trafo.lv_bus),
                "power_kva": float(trafo.sn_mva) * 1e3,
                "primary_kv": float(trafo.vn_hv_kv),
                "secondary_kv": float(trafo.vn_lv_kv),
                "clock": round(float(trafo.shift_degree) / 30.0) % 12,
                "tap_percent": _tap_percent(trafo),
                **_pi_model(trafo),
            }
            yield self._names.add(trafo.name, f"transformer_{trafo.Index}"), fields

    def _loads(self, table: str, sign: float) -> Iterator[tuple[str, dict[str, Any]]]:
        rows = self._net[table]
        for load in rows[rows.in_service].itertuples():
            shares = [
                getattr(load, f"const_{kind}_{part}", 0.0) for kind in "zi" for part in ("p_percent", "q_percent")
            ]
            if any(shares):
                raise InvalidConfig(f"load {load.name!r} depends on the voltage, which is not supported")
            fields = {
                "bus": self._names.at(load.bus),
                "power_w": sign * float(load.p_mw * load.scaling) * 1e6,
                "reactive_var": sign * float(load.q_mvar * load.scaling) * 1e6,
            }
            yield self._names.add(load.name, f"{table}_{load.Index}"), fields


def _tap_percent(trafo: Any) -> float:
    position, neutral = trafo.tap_pos, trafo.tap_neutral
    if position is None or isnan(position) or isnan(neutral) or position == neutral:
        return 0.0
    if trafo.tap_side != "hv":
        raise InvalidConfig(f"transformer {trafo.name!r}: a tap of its high-voltage side expected")
    return float((position - neutral) * trafo.tap_step_percent)


def _pi_model(trafo: Any) -> dict[str, float]:
    """Return the rating plate of the pi model that equals pandapower's T model, by the star-delta transformation.

    With the T model's series impedance z and shunt admittance y, both per unit of the transformer, the pi model has
    z (1 + z y / 4) and y / (1 + z y / 4).
    """
    power_mva = float(trafo.sn_mva)
    resistance, impedance = float(trafo.vkr_percent) / 100.0, float(trafo.vk_percent) / 100.0
    series = complex(resistance, sqrt(impedance**2 - resistance**2))
    conductance = float(trafo.pfe_kw) / 1e3 / power_mva
    susceptance = sqrt(max((float(trafo.i0_percent) / 100.0) ** 2 - conductance**2, 0.0))
    shunt = complex(conductance, -susceptance)
    factor = 1.0 + series * shunt / 4.0
    series, shunt = series * factor, shunt / factor
    return {
        "short_circuit_percent": abs(series) * 100.0,
        "copper_loss_w": series.real * power_mva * 1e6,
        "iron_loss_w": shunt.real * power_mva * 1e6,
        "no_load_percent": abs(shunt) * 100.0,
    }


def _connected(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields without what is not connected with the source."""
    branches = [
        (part["from"], part["to"], 0)
        for kind in ("lines", "transformers")
        for part in fields[kind].values()
        if not part.get("open_end")
    ]
    buses = bus_clocks(fields["source"]["bus"], branches)
    is_used: Callable[[dict[str, Any]], bool] = lambda part: all(  # noqa: E731
        part[end] in buses for end in ("bus", "from", "to") if end in part
    )
    kept = {
        kind: {name: part for name, part in fields[kind].items() if is_used(part)}
        for kind in ("lines", "transformers", "loads")
    }
    return {**fields, **kept, "buses": {name: bus for name, bus in fields["buses"].items() if name in buses}}
