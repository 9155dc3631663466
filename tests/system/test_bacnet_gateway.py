"""A node as a BACnet device: what a client reads, writes and is told, on a real node."""

import asyncio
import math
import socket
import struct
from collections.abc import Callable
from typing import Any

import pytest
from bacpypes3.apdu import WritePropertyMultipleRequest
from bacpypes3.basetypes import BinaryPV, PriorityValue, PropertyValue, WriteAccessSpecification
from bacpypes3.constructeddata import Any as AnyValue
from bacpypes3.primitivedata import CharacterString, Real, Unsigned
from support.bacnet import ADVANCE, DEVICE, INSTANCE, PAUSED, STEP, TIME, free_udp_port, served, single
from support.nodes import until

from zenostat import Bus
from zenostat.bridge.transport.session import open_session
from zenostat.gateways.bacnet import BacnetGateway
from zenostat.gateways.bacnet.cov import COV_INTERVAL_S
from zenostat.gateways.bacnet.network import find_interface
from zenostat.gateways.bus_side import BusMessage
from zenostat.gateways.node_client import NodeClient
from zenostat.topics import codec, keys
from zenostat.topics.errors import AddressInUse, InvalidConfig
from zenostat.topics.messages import Event, EventKind, Reset

COOLING, HEATING = "core_zn_cooling_setpoint", "core_zn_heating_setpoint"
INPUT = "core_zn_air_temperature"


@pytest.fixture
def paused_bus(stepping_bus: Bus) -> Bus:
    """A node that steps on command only, at the first sample."""
    stepping_bus.reset("office", Reset())
    return stepping_bus


@pytest.mark.slow
async def test_bacnet_gateway__points_have_the_values_units_and_bounds_of_the_node(paused_bus: Bus) -> None:
    manifest = paused_bus.manifest("office")
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        assert await reader.write(ADVANCE, 3.0) == "ok"
        sample = gateway._node.sample
        assert (await reader.read(STEP), sample.step) == (3.0, 3)
        for point in manifest.points:
            value = sample[point.name] / (manifest.step_s if point in manifest.meters else 1)
            assert await reader.read(point.name) == single(value), point.name
            assert await reader.read(point.name, "reliability") == "no-fault-detected"
        meter = next(meter for meter in manifest.meters if meter.unit == "J" and sample[meter.name] > 0)
        assert await reader.read(meter.name, "units") == "watts"
        assert "mean of the timestep" in await reader.read(meter.name, "description")
        assert await reader.read(INPUT, "units") == "degrees-celsius"
        actuator = next(a for a in manifest.actuators if a.name == COOLING)
        assert await reader.read(COOLING, "min-pres-value") == actuator.low
        assert await reader.read(COOLING, "max-pres-value") == actuator.high
        assert await reader.read(INPUT, "relinquish-default") == "property unknown-property"
        time = await reader.read(TIME)
        assert (*time.date[:3], *time.time[:2]) == (
            *(sample.time.year - 1900, sample.time.month, sample.time.day),
            *(sample.time.hour, sample.time.minute),
        )
        assert time.date[3] == sample.time.isoweekday()


async def test_bacnet_gateway__client_commands_an_output_at_its_priority_and_relinquishes_it(paused_bus: Bus) -> None:
    index = [a.name for a in paused_bus.manifest("office").actuators].index(COOLING)
    events: list[Event] = []
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        gateway._node.listeners.events.append(events.append)
        baseline = await reader.read(COOLING, "relinquish-default")
        assert baseline == single(gateway._node.sample.effective[index])
        assert await reader.read(COOLING) == baseline
        assert await reader.read(COOLING, "current-command-priority") is None
        assert await reader.write(COOLING, 26.1, priority=8) == "ok"
        assert await reader.write(COOLING, 25.0) == "ok"  # at priority 16
        assert await reader.read(COOLING) == single(26.1)
        assert await reader.read(COOLING, "current-command-priority") == 8
        assert await reader.priorities(COOLING) == {8: single(26.1), 16: 25.0}
        # In double precision the bus has what the client's user typed.
        assert paused_bus.priorities("office")[COOLING][7].value == 26.1
        assert await reader.read(COOLING, "interface-value") == baseline  # in effect from the next timestep
        assert await reader.write(ADVANCE, 1.0) == "ok"
        assert await reader.read(COOLING, "interface-value") == single(26.1)
        assert await reader.read(COOLING, "relinquish-default") == baseline
        assert await reader.write(COOLING, None, priority=8) == "ok"
        assert await reader.read(COOLING) == 25.0
        assert await reader.write(COOLING, None) == "ok"
        assert (await reader.read(COOLING), await reader.priorities(COOLING)) == (baseline, {})
        assert gateway.counts.writes == 5
    written = [event for event in events if event.kind is EventKind.WRITTEN]
    assert len(written) == 4
    assert all(event.source.startswith("bacnet.127.0.0.1_") for event in written)


async def test_bacnet_gateway__commands_of_others_on_the_bus_are_in_the_priority_array_at_once(paused_bus: Bus) -> None:
    async with served(paused_bus.endpoint) as (_, reader, _):
        await asyncio.to_thread(paused_bus.write, "office", COOLING, 24.5, priority=3, source="operator")
        assert await reader.priorities(COOLING) == {3: 24.5}
        assert await reader.read(COOLING) == 24.5
        await reader.write(COOLING, 27.0, priority=8)
        assert await reader.read(COOLING) == 24.5
        await asyncio.to_thread(paused_bus.write, "office", COOLING, None, priority=3, source="operator")
        assert await reader.priorities(COOLING) == {8: 27.0}
        assert await reader.read(COOLING, "priority-array", 0) == 16
        assert await reader.read(COOLING, "priority-array", 17) == "property invalid-array-index"


async def test_bacnet_gateway__other_building_with_the_same_points_is_described(paused_bus: Bus) -> None:
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        assert "USA_CO_Denver" in await reader.read(DEVICE, "description")
        before = await reader.read(INPUT)
        manifest = gateway._node.manifest.model_copy(update={"building": "b", "weather": "w", "location": "Paris"})
        for notify in gateway._node.listeners.manifests:
            notify(manifest)
        read = [await reader.read(DEVICE, name) for name in ("location", "model-name", "description")]
        assert read == ["Paris", "b", "simulated building b with weather w"]
        assert await reader.read(INPUT) == before  # of the same instance


REJECTED: list[tuple[str, Any, dict[str, Any], str]] = [
    (COOLING, 99.0, {}, "property value-out-of-range"),
    (COOLING, float("nan"), {}, "property value-out-of-range"),
    (COOLING, float("inf"), {}, "property value-out-of-range"),
    (COOLING, 26.0, {"priority": 6}, "property write-access-denied"),
    (COOLING, None, {"priority": 6}, "property write-access-denied"),
    (COOLING, 26.0, {"priority": 17}, "reject parameter-out-of-range"),
    (COOLING, 26.0, {"priority": 0}, "reject parameter-out-of-range"),
    (COOLING, CharacterString("26"), {}, "property invalid-data-type"),
    (COOLING, Unsigned(26), {}, "property invalid-data-type"),
    (COOLING, 26.0, {"index": 3}, "property property-is-not-an-array"),
    (COOLING, PriorityValue(real=26.0), {"prop": "priority-array", "index": 8}, "property write-access-denied"),
    (COOLING, 26.0, {"prop": "relinquish-default"}, "property write-access-denied"),
    (COOLING, CharacterString("mine"), {"prop": "object-name"}, "property write-access-denied"),
    (COOLING, 26.0, {"prop": "setpoint"}, "property unknown-property"),
    (COOLING, -1.0, {"prop": "cov-increment"}, "property value-out-of-range"),
    (INPUT, 20.0, {}, "property write-access-denied"),
    (INPUT, 20.0, {"prop": "low-limit"}, "property unknown-property"),
    ("office", CharacterString("mine"), {"prop": "object-name"}, "property write-access-denied"),
    ("node/step", 5.0, {}, "property write-access-denied"),
    ("node/advance", 0.5, {}, "property value-out-of-range"),
    ("node/advance", 0.0, {}, "property value-out-of-range"),
    ("node/advance", None, {}, "property invalid-data-type"),
]


async def test_bacnet_gateway__writes_that_are_not_possible_get_the_errors_of_the_standard_and_move_nothing(
    paused_bus: Bus,
) -> None:
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        for obj, value, options, expected in REJECTED:
            assert await reader.write(obj, value, **options) == expected, (obj, value, options)
        unknown = ("analog-output", 3)
        assert await reader.write(unknown, 26.0) == "object unknown-object"
        assert await reader.read(unknown) == "object unknown-object"
        several = WritePropertyMultipleRequest(
            listOfWriteAccessSpecs=[
                WriteAccessSpecification(
                    objectIdentifier=reader.identifier(name),
                    listOfProperties=[
                        PropertyValue(propertyIdentifier="present-value", value=AnyValue(Real(value)), priority=9)
                    ],
                )
                for name, value in ((HEATING, 18.0), (COOLING, 99.0), (COOLING, 26.0))
            ],
            destination=reader.device,
        )
        assert await reader.request(several) == "property value-out-of-range"
        assert (gateway.counts.writes, gateway.counts.rejected) == (1, len(REJECTED) + 3)
    arrays = paused_bus.priorities("office")
    commanded = {
        (name, number): entry.value
        for name, array in arrays.items()
        for number, entry in enumerate(array, 1)
        if entry.value is not None
    }
    assert commanded == {(HEATING, 9): 18.0}


async def test_bacnet_gateway__device_describes_itself_and_answers_who_is(paused_bus: Bus) -> None:
    manifest = paused_bus.manifest("office")
    async with served(paused_bus.endpoint) as (_, reader, port):
        (answer,) = await reader.app.who_is(address=reader.device, timeout=1)
        assert tuple(answer.iAmDeviceIdentifier) == (8, INSTANCE)
        assert await reader.app.who_is(INSTANCE + 1, INSTANCE + 2, address=reader.device, timeout=0.2) == []
        (reply,) = await reader.app.who_has(object_name=INPUT, address=reader.device, timeout=1)
        assert tuple(reply.objectIdentifier) == tuple(reader.identifier(INPUT))
        assert await reader.read(DEVICE, "object-name") == "office"
        assert await reader.read(DEVICE, "location") == manifest.location
        assert await reader.read(DEVICE, "system-status") == "operational"
        listed = await reader.read(DEVICE, "object-list")
        assert len(listed) == 7 + len(manifest.points) + len(manifest.actuators)
        port_object = ("network-port", 1)
        assert await reader.read(port_object, "ip-address") == bytes((127, 0, 0, 1))
        assert await reader.read(port_object, "ip-subnet-mask") == bytes((255, 0, 0, 0))
        assert await reader.read(port_object, "bacnet-ip-udp-port") == port
        names = await reader.read(COOLING, "property-list")
        for listed_property in names:
            value = await reader.read(COOLING, str(listed_property))
            assert not (isinstance(value, str) and value.startswith("property ")), (listed_property, value)


async def test_bacnet_gateway__broadcast_who_is_on_the_network_of_the_interface_is_answered(episode_bus: Bus) -> None:
    who_is = bytes.fromhex("810b000c0120ffff00ff1008")  # original broadcast, global network, all devices
    async with served(episode_bus.endpoint) as (_, _, port):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
            asking.settimeout(20.0)
            asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            asking.sendto(who_is, ("127.255.255.255", port))
            answer = await asyncio.to_thread(asking.recv, 2000)
    _, i_am, device = answer.partition(b"\x10\x00\xc4")  # an unconfirmed request, I-Am, an object identifier
    assert i_am
    assert int.from_bytes(device[:4], "big") == 8 << 22 | INSTANCE


async def test_bacnet_gateway__subscribers_hear_of_changes_beyond_the_increment_of_others_commands_and_of_the_end(
    paused_bus: Bus,
) -> None:
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        serving = asyncio.create_task(gateway.run())
        assert await reader.write(INPUT, 1000.0, "cov-increment") == "ok"
        subscribe = reader.app.change_of_value
        async with (
            subscribe(reader.device, reader.identifier(STEP), 1, True, 60) as steps,
            subscribe(reader.device, reader.identifier(COOLING), 2, False, 60) as commands,
            subscribe(reader.device, reader.identifier(INPUT), 3, True, 60) as silent,
        ):
            assert [await steps.get_value(), await steps.get_value()][0][1] == 0.0
            await commands.get_value(), await commands.get_value()
            await silent.get_value(), await silent.get_value()
            assert len(await reader.read(DEVICE, "active-cov-subscriptions")) == 3
            await reader.write(ADVANCE, 1.0)
            assert (await steps.get_value())[1] == 1.0
            await asyncio.to_thread(paused_bus.write, "office", COOLING, 24.5, priority=3, source="operator")
            assert (await commands.get_value())[1] == 24.5
            assert silent.queue.empty()
        assert len(await reader.read(DEVICE, "active-cov-subscriptions")) == 0
        serving.cancel()


async def test_bacnet_gateway__points_that_stay_keep_their_subscribers(paused_bus: Bus) -> None:
    """A node of the same name has come back with fewer points, which moves the others within a sample."""
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        serving = asyncio.create_task(gateway.run())
        manifest = paused_bus.manifest("office")
        kept = next(sensor.name for sensor in manifest.sensors[1:])
        fewer = manifest.model_copy(update={"sensors": manifest.sensors[1:], "instance": "1"})
        async with reader.app.change_of_value(reader.device, reader.identifier(COOLING), 2, False, 60) as commands:
            await commands.get_value(), await commands.get_value()
            gateway._set_manifest(fewer)
            assert len(await reader.read(DEVICE, "active-cov-subscriptions")) == 1
            await asyncio.to_thread(paused_bus.write, "office", COOLING, 24.5, priority=3, source="operator")
            assert (await commands.get_value())[1] == 24.5
        assert await reader.read(manifest.sensors[0].name) == "object unknown-object"
        (point,) = [point for point in gateway._points if point.point_name == kept]
        assert point._spec.position == 0
        serving.cancel()


async def test_bacnet_gateway__fast_simulation_sends_few_notifications_and_the_last_value_always(
    paused_bus: Bus,
) -> None:
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        serving = asyncio.create_task(gateway.run())
        begin = asyncio.get_running_loop().time()
        async with reader.app.change_of_value(reader.device, reader.identifier(STEP), 1, True, 60) as steps:
            assert await reader.write(ADVANCE, 90.0) == "ok"
            while (await steps.get_value())[1] != 90.0:
                pass
            duration_s = asyncio.get_running_loop().time() - begin
            assert gateway.counts.notifications <= duration_s / COV_INTERVAL_S + 2
        serving.cancel()


@pytest.mark.slow  # BACnet's own retries take 12 s
async def test_bacnet_gateway__subscriber_that_has_not_confirmed_gets_the_last_state(paused_bus: Bus) -> None:
    def values(datagram: bytes) -> tuple[int, float] | None:
        """Number of a confirmed COV notification's request, and the present value in it."""
        head, mark, value = datagram[6:].partition(bytes.fromhex("09552e44"))  # property 85, a real
        return (head[2], struct.unpack(">f", value[:4])[0]) if mark and head[0] >> 4 == 0 else None

    async with served(paused_bus.endpoint) as (gateway, reader, port):
        serving = asyncio.create_task(gateway.run())
        # Subscribe COV: process 7, analog value 2 (the step), confirmed, for 120 s.
        subscribe = bytes.fromhex("0104 0005 2a05 0907 1c00800002 2901 3978")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as subscriber:
            subscriber.bind(("127.0.0.1", 0))
            subscriber.settimeout(30.0)
            subscriber.sendto(b"\x81\x0a" + (4 + len(subscribe)).to_bytes(2) + subscribe, ("127.0.0.1", port))

            async def notified() -> tuple[int, float]:
                while (request_value := values(await asyncio.to_thread(subscriber.recv, 2000))) is None:
                    pass
                return request_value

            first, value = await notified()
            assert value == 0.0
            assert await reader.write(ADVANCE, 1.0) == "ok"
            await asyncio.sleep(2 * COV_INTERVAL_S)
            request, value = first, 0.0
            while request == first:  # nothing is confirmed until the stack gives up
                request, value = await notified()
            assert value == 1.0
        serving.cancel()


async def test_bacnet_gateway__value_without_a_number_in_single_precision_and_a_failed_simulation_are_faults(
    paused_bus: Bus,
) -> None:
    async with served(paused_bus.endpoint) as (gateway, reader, _):
        state = gateway._state
        position = paused_bus.manifest("office").names.index(INPUT)
        state._values = state._values.copy()
        state._values[position] = math.nan
        assert math.isnan(await reader.read(INPUT))
        assert await reader.read(INPUT, "reliability") == "unreliable-other"
        assert [int(flag) for flag in await reader.read(INPUT, "status-flags")] == [0, 1, 0, 0]
        assert await reader.read(COOLING, "reliability") == "no-fault-detected"
        for value, fault in ((1e39, "over-range"), (-1e39, "under-range"), (3.4e38, "no-fault-detected")):
            state._values[position] = value  # the largest number in single precision is 3.403e38
            assert await reader.read(INPUT, "reliability") == fault
        failed = codec.encode(Event(kind=EventKind.FAILED, text="it failed"))
        state.node._handle(BusMessage(keys.EVENT.at("office"), codec.encoding(Event), failed))
        assert await reader.read(COOLING, "reliability") == "process-error"
        assert await reader.read(DEVICE, "system-status") == "non-operational"
        assert await reader.write(ADVANCE, 1.0) == "ok"
        while await reader.read(STEP) != 1.0:
            pass
        assert await reader.read(INPUT, "reliability") == "no-fault-detected"


async def test_bacnet_gateway__paused_node_steps_on_command_and_a_running_one_does_not(paused_bus: Bus) -> None:
    async with served(paused_bus.endpoint) as (_, reader, _):
        assert await reader.read(PAUSED) == "active"
        assert await reader.write(ADVANCE, 96.0) == "ok"
        while await reader.read(ADVANCE):
            pass
        assert await reader.read(STEP) == 96.0
        assert await reader.write(ADVANCE, 1.0) == "property write-access-denied"  # the episode is over
        await asyncio.to_thread(paused_bus.pace, "office", mode="lockstep")
        await asyncio.to_thread(paused_bus.reset, "office", Reset())
        assert await reader.write(PAUSED, BinaryPV("inactive")) == "ok"
        assert await reader.read(PAUSED) == "inactive"
        assert await reader.write(ADVANCE, 1.0) == "property write-access-denied"


@pytest.mark.parametrize("cancel", [lambda bus: bus.pause("office"), lambda bus: bus.reset("office", Reset())])
async def test_bacnet_gateway__steps_left_are_those_of_the_node_whoever_requests_or_cancels_them(
    paused_bus: Bus, cancel: Callable[[Bus], object]
) -> None:
    paused_bus.pace("office", mode="lockstep")
    async with served(paused_bus.endpoint) as (_, reader, _):
        with paused_bus.controller("office", name="silent"):  # the node waits for its command
            assert await reader.write(ADVANCE, 50.0) == "ok"
            assert await reader.read(ADVANCE) == 50.0
            assert await reader.write(ADVANCE, 1.0) == "device device-busy"
            await asyncio.to_thread(cancel, paused_bus)
            assert await reader.read(ADVANCE) == 0.0
            await asyncio.to_thread(paused_bus.step, "office", 3)
            assert await reader.read(ADVANCE) == 3.0
            assert await reader.write(PAUSED, BinaryPV("active")) == "ok"
            assert await reader.write(ADVANCE, 2.0) == "ok"
            assert await reader.read(ADVANCE) == 2.0


async def test_bacnet_gateway__address_in_use_or_of_no_interface_is_refused_before_anything_starts(
    episode_bus: Bus,
) -> None:
    port = free_udp_port()
    with open_session(connect=[episode_bus.endpoint]) as session:
        async with NodeClient(session, "office") as node:
            first = BacnetGateway(node, find_interface("127.0.0.1", port), instance=1)
            second = BacnetGateway(node, find_interface("127.0.0.1", port), instance=2)
            async with first:
                with pytest.raises(AddressInUse, match=f"UDP port {port}"):
                    await second.__aenter__()
    with pytest.raises(InvalidConfig, match=r"127\.0\.0\.1 \(lo\)"):
        find_interface("0.0.0.0", port)
    with pytest.raises(InvalidConfig, match="IPv4"):
        find_interface("::1", port)
    assert find_interface("127.0.0.7", port).broadcast == "127.255.255.255"
    until(lambda: episode_bus.status("office"), "the node answers")
