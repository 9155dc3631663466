"""BACnet objects of a node's points, which read the node's state when a client reads them."""

from __future__ import annotations

import math
from typing import Any

from bacpypes3.basetypes import (
    OptionalReal,
    OptionalUnsigned,
    PriorityArray,
    PriorityValue,
    PropertyIdentifier,
    Reliability,
)
from bacpypes3.constructeddata import ArrayOf
from bacpypes3.errors import PropertyError
from bacpypes3.local.object import Object
from bacpypes3.object import AnalogInputObject, AnalogOutputObject
from bacpypes3.primitivedata import Null, ObjectIdentifier, Real

from zenostat.gateways.bacnet.cov import CovCriteria
from zenostat.gateways.bacnet.node_state import NodeState
from zenostat.gateways.bacnet.points import PointSpec
from zenostat.gateways.bacnet.units import bacnet_unit
from zenostat.gateways.single_precision import intended, single
from zenostat.topics.points import contains

RESERVED_PRIORITY = 6
"""Priority of minimum on and off times (ASHRAE 135, clause 19.2.3), which clients must not write."""

_NOT_LISTED = ("objectIdentifier", "objectName", "objectType", "propertyList")  # clause 12.1.1.4.2

_ArrayOfPropertyIdentifier = ArrayOf(PropertyIdentifier)


def real(value: float) -> Real:
    """Return a value in single precision, infinite where that has no such number."""
    return Real(single(value))


class NodeObject(Object):
    """Base class of the gateway's objects: a client can write `_writable` properties only.

    Args:
        state: the node's state.
        properties: initial values of the object's BACnet properties.
    """

    _cov_criteria = CovCriteria
    _writable: frozenset[str] = frozenset()
    _needs_arrays: frozenset[str] = frozenset()

    def __init__(self, state: NodeState, **properties: Any) -> None:
        self._state = state
        super().__init__(eventState="normal", outOfService=False, **properties)

    @property
    def propertyList(self) -> Any:
        """Identifiers of the object's properties, without the four that each object has."""
        return _ArrayOfPropertyIdentifier(
            [listed for listed in Object.propertyList.fget(self) if listed.attr not in _NOT_LISTED]
        )

    @propertyList.setter
    def propertyList(self, value: Any) -> None:
        pass  # bacpypes3 sets it to None

    @property
    def reliability(self) -> Reliability:
        """No fault, or why the present value is not to be trusted."""
        if not self._state.is_reachable:
            return Reliability("communication-failure")
        if self._state.has_failed:
            return Reliability("process-error")
        return Reliability(self._reliability_of_value())

    def _reliability_of_value(self) -> str:
        """Return the reliability while the node is well."""
        return "no-fault-detected"

    async def read_property(self, attr: Any, index: int | None = None) -> Any:
        """Return a property's value, as of after the request."""
        if self._needs_arrays and (attr if isinstance(attr, str) else attr.attr) in self._needs_arrays:
            await self._state.arrays.get()
        return await super().read_property(attr, index)

    @property
    def point_name(self) -> str:
        """The name by which permissions know it: of a point that on the bus, of others the object's."""
        return str(self.objectName)

    def is_writable(self, attr: str) -> bool:
        """Whether clients can write a property."""
        return attr in self._writable

    async def write_property(
        self, attr: Any, value: Any, index: int | None = None, priority: int | None = None
    ) -> None:
        """Write a property; `PropertyError` or an error of the bus tells why not."""
        name = attr if isinstance(attr, str) else attr.attr
        if not self.is_writable(name):
            raise PropertyError("writeAccessDenied")
        if name != "presentValue":
            if isinstance(value, Null):
                raise PropertyError("invalidDataType")
            if name == "covIncrement" and not 0 <= value < math.inf:
                raise PropertyError("valueOutOfRange")
            await super().write_property(attr, value, index)
        else:
            await self.command(value, priority)

    async def command(self, value: Any, priority: int | None) -> None:  # noqa: ARG002
        """Write the present value."""
        raise PropertyError("writeAccessDenied")


class _Analog(NodeObject):
    """Properties that analog inputs and outputs have in common."""

    _writable = frozenset({"covIncrement"})

    def __init__(self, state: NodeState, spec: PointSpec) -> None:
        self._spec = spec
        unit = bacnet_unit(spec.unit)
        properties = {
            "objectIdentifier": ObjectIdentifier((spec.kind.value, spec.instance)),
            "objectName": spec.object_name,
            "description": spec.description or spec.name,
            "units": unit.name,
            "covIncrement": real(unit.increment),
        }
        for name, bound in (("minPresValue", spec.low), ("maxPresValue", spec.high)):
            if bound is not None:
                properties[name] = real(bound)
        super().__init__(state, **properties)

    @property
    def point_name(self) -> str:
        """The point's name on the bus."""
        return self._spec.name

    def move(self, position: int) -> None:
        """Have the value of another place in the samples."""
        self._spec = self._spec._replace(position=position)

    @property
    def presentValue(self) -> Real:
        """The present value."""
        return real(self._value())

    def _value(self) -> float:
        raise NotImplementedError

    def _reliability_of_value(self) -> str:
        value = single(self._value())
        if math.isinf(value):
            return "over-range" if value > 0.0 else "under-range"
        return "unreliable-other" if math.isnan(value) else "no-fault-detected"


class AnalogInput(_Analog, AnalogInputObject):
    """A sensor or meter."""

    def _value(self) -> float:
        return self._state.value(self._spec.position) / self._spec.divisor


class AnalogOutput(_Analog, AnalogOutputObject):
    """An actuator, with its priority array on the bus."""

    _writable = frozenset({"covIncrement", "presentValue"})
    _of_arrays = frozenset({"priorityArray", "currentCommandPriority"})
    _needs_arrays = _of_arrays | {"presentValue", "relinquishDefault", "reliability", "statusFlags"}

    async def read_property(self, attr: Any, index: int | None = None) -> Any:
        """Return a property's value; `PropertyError` for priorities that the node does not report."""
        value = await super().read_property(attr, index)
        if not self._state.has_arrays and (attr if isinstance(attr, str) else attr.attr) in self._of_arrays:
            raise PropertyError("valueNotInitialized")
        return value

    def _command(self) -> tuple[int | None, float]:
        """Return the priority in effect and its value; None and the relinquish default if nobody commands it."""
        for priority, entry in enumerate(self._state.priority_array(self._spec.name), 1):
            if entry.value is not None:
                return priority, entry.value
        commanded = math.nan if self._state.has_arrays else self._state.commanded(self._spec.position)
        return None, self._state.baseline(self._spec.position) if math.isnan(commanded) else commanded

    def _value(self) -> float:
        return self._command()[1]

    @property
    def priorityArray(self) -> Any:
        """The 16 values, Null where nobody commands."""
        entries = self._state.priority_array(self._spec.name)
        return PriorityArray(
            [
                PriorityValue(null=()) if entry.value is None else PriorityValue(real=real(entry.value))
                for entry in entries
            ]
        )

    @property
    def relinquishDefault(self) -> Real:
        """The value of the baseline control, as far as known."""
        return real(self._state.baseline(self._spec.position))

    @property
    def currentCommandPriority(self) -> Any:
        """The priority in effect, Null for the baseline control."""
        priority = self._command()[0]
        return OptionalUnsigned(null=()) if priority is None else OptionalUnsigned(unsigned=priority)

    @property
    def interfaceValue(self) -> Any:
        """The value in effect in the latest timestep, Null where it is not reported."""
        value = self._state.effective(self._spec.position)
        return OptionalReal(null=()) if math.isnan(value) else OptionalReal(real=real(value))

    async def command(self, value: Any, priority: int | None) -> None:
        """Write at a priority (None: 16) or, with Null, relinquish it."""
        priority = 16 if priority is None else priority
        if priority == RESERVED_PRIORITY:
            raise PropertyError("writeAccessDenied")
        if isinstance(value, Null):
            await self._state.write(self._spec.name, None, priority)
            return
        spec, number = self._spec, intended(self._spec, single(value))
        if not contains(spec, number):
            raise PropertyError("valueOutOfRange")
        await self._state.write(spec.name, number, priority)
