"""The systems of a plant: components and loops of a building, electric grids, and the members of a district."""

from __future__ import annotations

from zenostat.topics.messages.base import Count, Message


class SystemNode(Message):
    """A node at a component: its name, and the port in words, such as `water outlet`."""

    name: str
    port: str


class SystemComponent(Message):
    """A component of a system: a coil, a fan, a chiller, a terminal unit.

    `kind`, `name`: type and name of the object in the model. `inlets`, `outlets`: its nodes. `parts`: indices
    into `Systems.components` of what it consists of, such as the fan and the coils of a unitary system.
    """

    kind: str
    name: str
    inlets: tuple[SystemNode, ...] = ()
    outlets: tuple[SystemNode, ...] = ()
    parts: tuple[Count, ...] = ()


class LoopSide(Message):
    """A side of a loop: `supply` or `demand`.

    `stages`: in the direction of flow; each has the branches that are parallel there, and a branch the indices of its
    components in the direction of flow. A branch without components is a bypass.
    """

    name: str
    stages: tuple[tuple[tuple[Count, ...], ...], ...] = ()


class ServedZone(Message):
    """A zone with the equipment that serves it, as indices into `Systems.components`."""

    zone: str
    equipment: tuple[Count, ...] = ()


class SystemLoop(Message):
    """An air loop, a plant loop or a condenser loop.

    `kind`, `name`: type and name of the object in the model. `sides`: of an air loop, its supply side. `zones`: those
    that an air loop serves, with their terminal units.
    """

    kind: str
    name: str
    sides: tuple[LoopSide, ...]
    zones: tuple[ServedZone, ...] = ()


class GridBranch(Message):
    """A branch of an electric grid between two buses; `kind`: `line` or `transformer`."""

    name: str
    kind: str
    start: str
    end: str


class GridDevice(Message):
    """A device that is connected to a bus; `kind`: `load`, `pv`, `battery` or `charger`."""

    name: str
    kind: str
    bus: str


class ElectricGrid(Message):
    """An electric grid for a one-line diagram.

    `prefix`: before the names of its points, such as `feeder.` in a district. `source`: the bus of the supply.
    """

    prefix: str = ""
    source: str
    buses: tuple[str, ...]
    branches: tuple[GridBranch, ...]
    devices: tuple[GridDevice, ...] = ()


class DistrictMember(Message):
    """A plant of a district; `kind`: `building`, `grid`, `market`, …; `node`: its name on the bus, if it is there."""

    name: str
    kind: str
    node: str = ""


class Systems(Message):
    """The systems of a plant; a component that is on several loops, such as a water coil, is listed once.

    `zones`: zones with equipment that is on no air loop, such as radiators and fan coils.
    """

    components: tuple[SystemComponent, ...] = ()
    loops: tuple[SystemLoop, ...] = ()
    zones: tuple[ServedZone, ...] = ()
    grids: tuple[ElectricGrid, ...] = ()
    members: tuple[DistrictMember, ...] = ()
