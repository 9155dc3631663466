"""BACnet objects of the simulation itself: its time, pausing it and stepping on command."""

from __future__ import annotations

from typing import Any

from bacpypes3.basetypes import BinaryPV, DateTime
from bacpypes3.errors import ExecutionError, PropertyError
from bacpypes3.object import AnalogValueObject, BinaryValueObject, DateTimeValueObject
from bacpypes3.primitivedata import Date, Null, Real, Time

from zenostat.gateways.bacnet.fixed_objects import ADVANCE, EPISODE, MAX_STEPS, PAUSED, STEP, TIME, FixedObject
from zenostat.gateways.bacnet.node_state import NodeState
from zenostat.gateways.bacnet.point_objects import NodeObject, real

_YEARS = range(255)
"""Years since 1900 that a BACnet date can have (ASHRAE 135, clause 20.2.12); 255 is any year."""


class StatusObject(NodeObject):
    """An object whose value is in the node's status."""

    async def read_property(self, attr: Any, index: int | None = None) -> Any:
        """Return a property's value, as of after the request."""
        if (attr if isinstance(attr, str) else attr.attr) == "presentValue":
            await self._state.status.get()
        return await super().read_property(attr, index)


class _AnalogValue(NodeObject, AnalogValueObject):
    def __init__(self, state: NodeState, fixed: FixedObject, **properties: Any) -> None:
        super().__init__(state, **_properties(fixed), units="noUnits", covIncrement=0.0, **properties)


class Advance(StatusObject, _AnalogValue):
    """Number of timesteps that the paused node still has to simulate; a write requests some."""

    _writable = frozenset({"presentValue", "covIncrement"})

    def __init__(self, state: NodeState) -> None:
        super().__init__(state, ADVANCE, minPresValue=ADVANCE.low, maxPresValue=ADVANCE.high)

    @property
    def presentValue(self) -> Real:
        """Timesteps left."""
        return real(self._state.steps_left)

    async def command(self, value: Any, priority: int | None) -> None:  # noqa: ARG002 - not commandable: no priority
        """Simulate some timesteps."""
        if isinstance(value, Null):
            raise PropertyError("invalidDataType")
        if not (1 <= value <= MAX_STEPS and float(value).is_integer()):
            raise PropertyError("valueOutOfRange")
        await self._state.status.get()
        if self._state.steps_left:
            raise ExecutionError("device", "deviceBusy")
        await self._state.advance(int(value))


class Step(_AnalogValue):
    """Number of the latest sample in its episode."""

    def __init__(self, state: NodeState) -> None:
        super().__init__(state, STEP)

    @property
    def presentValue(self) -> Real:
        """The number; 0 is the state after warm-up."""
        sample = self._state.sample
        return real(sample.step if sample else 0)


class Episode(_AnalogValue):
    """Number of the episode."""

    def __init__(self, state: NodeState) -> None:
        super().__init__(state, EPISODE)

    @property
    def presentValue(self) -> Real:
        """The number, from 0."""
        sample = self._state.sample
        return real(sample.episode if sample else 0)


class Paused(StatusObject, BinaryValueObject):
    """Whether the node is paused; a write pauses or resumes it."""

    _writable = frozenset({"presentValue"})

    def __init__(self, state: NodeState) -> None:
        super().__init__(state, **_properties(PAUSED), activeText="paused", inactiveText="running")

    @property
    def presentValue(self) -> BinaryPV:
        """Active while it is paused."""
        status = self._state.status.value
        return BinaryPV("active" if status is not None and status.paused else "inactive")

    async def command(self, value: Any, priority: int | None) -> None:  # noqa: ARG002 - not commandable: no priority
        """Pause or resume the node."""
        if isinstance(value, Null):
            raise PropertyError("invalidDataType")
        if value not in (BinaryPV.active, BinaryPV.inactive):
            raise PropertyError("valueOutOfRange")
        await self._state.set_paused(paused=value == BinaryPV.active)


class SimulatedTime(NodeObject, DateTimeValueObject):
    """Simulated local standard time of the latest sample."""

    def __init__(self, state: NodeState) -> None:
        super().__init__(state, **_properties(TIME), isUTC=False)

    @property
    def presentValue(self) -> DateTime:
        """Date and time at the end of the timestep; unspecified before the first sample, and in years BACnet lacks."""
        sample = self._state.sample
        if sample is None or sample.time.year - 1900 not in _YEARS:
            return DateTime(date=Date((255, 255, 255, 255)), time=Time((255, 255, 255, 255)))
        time = sample.time
        return DateTime(
            date=Date((time.year - 1900, time.month, time.day, time.isoweekday())),
            time=Time((time.hour, time.minute, time.second, time.microsecond // 10_000)),
        )


def _properties(fixed: FixedObject) -> dict[str, Any]:
    return {
        "objectIdentifier": (fixed.kind, fixed.instance),
        "objectName": fixed.object_name,
        "description": fixed.description,
    }


def control_objects(state: NodeState) -> list[NodeObject]:
    """Return the objects of the simulation itself; their instance numbers are fixed."""
    return [Advance(state), Step(state), Episode(state), Paused(state), SimulatedTime(state)]
