"""Electric grids and the members of a district for the page, with the points that belong to them."""

from __future__ import annotations

from typing import Any

from zenostat.topics.messages import DistrictMember, ElectricGrid, Manifest, Systems

_MARKET = ("price", "demand", "cleared_demand", "limit", "cleared", "trials")


def district(systems: Systems, manifest: Manifest) -> dict[str, Any]:
    """Return `grids`, `members` and `solved`; values are indices of points, None without such a point.

    A grid's points have the names of docs/grid.md: `BUS_voltage`, `LINE_loading`, `DEVICE_power`. `solved` are pairs of
    a solved connection or loop and its points: `residual`, and of loops `trials` and `solved`.
    """
    places = {point.name: index for index, point in enumerate(manifest.points)}
    return {
        "grids": [_grid(grid, places) for grid in systems.grids],
        "members": [_member(member, places) for member in systems.members],
        "solved": _solved(places) if systems.members else [],
    }


def _grid(grid: ElectricGrid, places: dict[str, int]) -> dict[str, Any]:
    def place(name: str, suffix: str) -> int | None:
        return places.get(f"{grid.prefix}{name}{suffix}")

    return {
        "name": grid.prefix.rstrip("."),
        "source": grid.source,
        "import": place("import", ""),
        "export": place("export", ""),
        "buses": [{"name": bus, "voltage": place(bus, "_voltage")} for bus in grid.buses],
        "branches": [
            branch.model_dump(mode="json") | {"loading": place(branch.name, "_loading")} for branch in grid.branches
        ],
        "devices": [
            device.model_dump(mode="json")
            | {"power": place(device.name, "_power"), "charge": place(device.name, "_state_of_charge")}
            for device in grid.devices
        ],
    }


def _member(member: DistrictMember, places: dict[str, int]) -> dict[str, Any]:
    start = f"{member.name}."
    market = {name: places.get(f"{start}{name}") for name in _MARKET} if member.kind == "market" else None
    power = next((places[start + name] for name in _POWERS if start + name in places), None)
    return {
        "name": member.name,
        "kind": member.kind,
        "node": member.node,
        "available": places.get(f"plant.{member.name}.available"),
        "power": power,
        "points": sum(name.startswith(start) for name in places),
        "market": market,
    }


_POWERS = ("electricity_facility", "electricity", "import", "power", "heat", "demand")
"""Points of a member that say how much it draws, the first that it has."""


def _solved(places: dict[str, int]) -> list[dict[str, Any]]:
    """Return the solved connections, then the loops."""
    connections = [
        {"name": name.removeprefix("residual."), "kind": "connection", "residual": place}
        for name, place in places.items()
        if name.startswith("residual.")
    ]
    loops = [
        {
            "name": name[len("loop.") : -len(".residual")],
            "kind": "loop",
            "residual": place,
            "trials": places.get(f"{name.removesuffix('residual')}trials"),
            "solved": places.get(f"{name.removesuffix('residual')}solved"),
        }
        for name, place in places.items()
        if name.startswith("loop.") and name.endswith(".residual")
    ]
    return [*connections, *loops]
