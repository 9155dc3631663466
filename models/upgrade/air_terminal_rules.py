"""Uncontrolled air terminals become terminals of constant volume (9.2 to 9.3; Input Changes 9.2.0 to 9.3.0).

The new terminal has an inlet node and an air distribution unit. The node before it, which splitters, plenums and air
loops name, was the zone's supply node; it gets a name of its own.
"""

from __future__ import annotations

from typing import Any

from zenostat.models.upgrade.step import UpgradingModel

_OLD, _NEW = "AirTerminal:SingleDuct:Uncontrolled", "AirTerminal:SingleDuct:ConstantVolume:NoReheat"
_UNIT, _LIST = "ZoneHVAC:AirDistributionUnit", "ZoneHVAC:EquipmentList"
_SIZING = "design_specification_air_terminal_sizing_object_name"
_INLET = " ATInlet"
_OUTLETS = (("AirLoopHVAC:ZoneSplitter", "nodes"), ("AirLoopHVAC:SupplyPlenum", "nodes"))
_AIR_LOOP_FIELD = "demand_side_inlet_node_names"


def uncontrolled_terminals(model: UpgradingModel) -> None:
    """Replace the terminals, and rename the nodes before them."""
    terminals = model.items(_OLD)
    if not terminals:
        return
    inlets = {str(f["zone_supply_air_node_name"]).casefold(): f"{f['zone_supply_air_node_name']}{_INLET}"
              for _, f in terminals if f.get("zone_supply_air_node_name")}  # fmt: skip
    for name, fields in model.items("AirflowNetwork:Distribution:Node"):
        if str(fields.get("component_name_or_node_name", "")).casefold() in inlets:
            reason = f"it names the node of an {_OLD}; replace that terminal by an {_NEW}"
            model.refuse("AirflowNetwork:Distribution:Node", name, reason, "component_name_or_node_name")
    units = {name.casefold(): _replace_terminal(model, name, fields) for name, fields in terminals}
    for name, fields in model.items(_LIST):
        for entry in fields.get("equipment", ()):
            if str(entry.get("zone_equipment_object_type", "")).casefold() == _OLD.casefold():
                unit = units.get(str(entry.get("zone_equipment_name", "")).casefold())
                if unit is None:
                    model.refuse(_LIST, name, f"it names an {_OLD} that the model does not have", "equipment")
                    continue
                entry |= {"zone_equipment_object_type": _UNIT, "zone_equipment_name": unit}
                model.note(_LIST, name, f"its {_OLD} is now the {_UNIT} {unit!r}")
    _rename_nodes_before(model, inlets)


def _replace_terminal(model: UpgradingModel, name: str, fields: dict[str, Any]) -> str:
    node = str(fields.pop("zone_supply_air_node_name", ""))
    sizing = fields.pop(_SIZING, "")
    terminal = {"air_inlet_node_name": f"{node}{_INLET}", "air_outlet_node_name": node, **fields}
    new = model.add(_NEW, name, terminal, source=(_OLD, name))
    unit = {"air_distribution_unit_outlet_node_name": node, "air_terminal_object_type": _NEW, "air_terminal_name": new}
    added = model.add(_UNIT, f"{name} ADU", unit | ({_SIZING: sizing} if sizing else {}), source=(_OLD, name))
    model.remove(_OLD, name, f"is now an {_NEW} with an {_UNIT}")
    return added


def _rename_nodes_before(model: UpgradingModel, inlets: dict[str, str]) -> None:
    """Rename nodes in splitters, plenums and air loops."""
    nodes = _NodesBefore(model, inlets)
    for kind, list_name in _OUTLETS:
        for name, fields in model.items(kind):
            for entry in fields.get(list_name, ()):
                nodes.rename(kind, name, entry, "outlet_node_name")
    for name, fields in model.items("AirLoopHVAC"):
        nodes.rename("AirLoopHVAC", name, fields, _AIR_LOOP_FIELD)


class _NodesBefore:
    """New names of the nodes before the terminals; a list of nodes that has one is copied first."""

    def __init__(self, model: UpgradingModel, inlets: dict[str, str]) -> None:
        self._model, self._inlets = model, inlets
        self._lists = {name.casefold(): (name, fields) for name, fields in model.items("NodeList")}
        self._copies: dict[str, str] = {}

    def rename(self, kind: str, name: str, fields: dict[str, Any], key: str) -> None:
        """Rename the node, or the list of nodes, in a field."""
        old = str(fields.get(key, ""))
        new = self._renamed(old)
        if new != old:
            fields[key] = new
            self._model.note(kind, name, f"{key} {old!r} is now {new!r}")

    def _renamed(self, text: str) -> str:
        folded = text.casefold()
        if folded in self._inlets:
            return self._inlets[folded]
        name, fields = self._lists.get(folded, ("", {}))
        nodes = [str(entry.get("node_name", "")) for entry in fields.get("nodes", ())]
        if not any(node.casefold() in self._inlets for node in nodes):
            return text
        if folded not in self._copies:
            entries = [{"node_name": self._inlets.get(node.casefold(), node)} for node in nodes]
            copy = self._model.add("NodeList", f"{name}{_INLET}", {"nodes": entries}, source=("NodeList", name))
            self._copies[folded] = copy
        return self._copies[folded]
