"""Erroneous and malicious requests of BACnet clients: answered, counted, and without effect."""

import asyncio
import random
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from bacpypes3.apdu import SubscribeCOVRequest
from support.bacnet import PAUSED, STEP, Client, client, served

from zenostat import Bus
from zenostat.gateways.bacnet import services, transactions

COOLING = "core_zn_cooling_setpoint"
OUTPUT = 1  # number of the object type analog-output
FUZZED = 4_000
CONFIRMED, ERROR, REJECT, ABORT = 0, 5, 6, 7


@contextmanager
def raw_socket() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw:
        raw.bind(("127.0.0.1", 0))
        raw.settimeout(20.0)
        yield raw


def datagram(apdu: bytes, function: int = 0x0A) -> bytes:
    """An APDU in an NPDU of a local station that expects a reply, in a unicast message of BACnet/IP."""
    npdu = b"\x01\x04" + apdu
    return struct.pack(">BBH", 0x81, function, 4 + len(npdu)) + npdu


def write_request(instance: int, value: bytes, priority: bytes, *, invoke_id: int = 1) -> bytes:
    """A WriteProperty of an output's present value; `value` and `priority` are tags."""
    identifier = struct.pack(">BI", 0x0C, OUTPUT << 22 | instance)
    return bytes((0x00, 0x05, invoke_id, 15)) + identifier + b"\x19\x55\x3e" + value + b"\x3f" + priority


def real(value: float) -> bytes:
    return b"\x44" + struct.pack(">f", value)


async def ask(raw: socket.socket, port: int, message: bytes) -> bytes:
    """Send a datagram and return the APDU of the reply."""
    await asyncio.to_thread(raw.sendto, message, ("127.0.0.1", port))
    return (await asyncio.to_thread(raw.recv, 2000))[6:]


def commanded(bus: Bus) -> dict[tuple[str, int], float]:
    return {
        (name, number): entry.value
        for name, array in bus.priorities("office").items()
        for number, entry in enumerate(array, 1)
        if entry.value is not None
    }


@pytest.mark.slow
async def test_bacnet_gateway__malformed_requests_are_rejected_and_half_datagrams_counted(episode_bus: Bus) -> None:
    async with served(episode_bus.endpoint) as (gateway, reader, port):
        instance = reader.objects[COOLING][1]
        whole = datagram(write_request(instance, real(26.0), b"\x49\x08"))
        with raw_socket() as raw:
            # A datagram that was cut has no reply: its length tells that it is not whole.
            before = gateway.counts.malformed
            for length in range(len(whole)):
                raw.sendto(whole[:length], ("127.0.0.1", port))
            # The same requests, cut before they were put into a datagram.
            apdu = write_request(instance, real(26.0), b"\x49\x08")
            for length in range(4, len(apdu) - 2):  # without its priority it is a request like others
                reply = await ask(raw, port, datagram(apdu[:2] + bytes([length]) + apdu[3:length]))
                assert reply[0] >> 4 in (REJECT, ERROR), (length, reply)
                assert reply[1] == length
            unknown_service = await ask(raw, port, datagram(b"\x00\x05\x63\xc8"))
            assert unknown_service == bytes((REJECT << 4, 0x63, 9))  # unrecognized-service
            device = struct.pack(">BI", 0x0C, 8 << 22 | 4_194_303)
            by_position = b"\x3e\x21\x01\x31\x05\x3f"
            read_range = await ask(raw, port, datagram(b"\x00\x05\x64\x1a" + device + b"\x19\x4c" + by_position))
            assert read_range == bytes((REJECT << 4, 0x64, 9))
            assert gateway.counts.malformed - before == len(whole)
        assert await reader.read(COOLING, "priority-array", 8) is None
    assert commanded(episode_bus) == {}


@pytest.mark.slow
@pytest.mark.parametrize(("code", "longest"), [(0, 50), (1, 128), (2, 206), (3, 480), (4, 1024), (5, 1476)])
async def test_bacnet_gateway__no_reply_is_longer_than_its_client_accepts(
    episode_bus: Bus, code: int, longest: int
) -> None:
    """The octets of each segment with its header; together they are the whole reply."""
    async with served(episode_bus.endpoint) as (_, _, port):
        with raw_socket() as raw:
            device = struct.pack(">BI", 0x0C, 8 << 22 | 4_194_303)
            every_property = device + b"\x1e\x09\x08\x1f"
            reply = await ask(raw, port, datagram(bytes((0x02, code, 7, 14)) + every_property))
            segments = [reply]
            while reply[0] & 0x0C == 0x0C:  # segmented, more follow
                reply = await ask(raw, port, datagram(bytes((0x40, 7, reply[2], 1))))
                segments.append(reply)
    assert max(map(len, segments)) <= longest
    is_segmented = bool(segments[0][0] & 0x08)
    assert is_segmented == (len(segments) > 1)
    assert all(len(segment) == longest for segment in segments[:-1])
    assert b"".join(segment[5 if is_segmented else 3 :] for segment in segments).startswith(device[:1])


@pytest.mark.slow
async def test_bacnet_gateway__random_and_mutated_datagrams_crash_nothing_and_move_no_other_actuator(
    episode_bus: Bus,
) -> None:
    """Mutations of valid writes may be valid; those of one output only, within its bounds."""
    draw = random.Random(7)

    def mutated(instance: int) -> bytes:
        apdu = bytearray(write_request(instance, real(26.0), b"\x49\x08", invoke_id=draw.randrange(256)))
        match draw.randrange(4):
            case 0:
                return draw.randbytes(draw.randrange(60))
            case 1:
                return datagram(draw.randbytes(draw.randrange(60)))
            case 2:
                return datagram(
                    bytes((draw.randrange(256), draw.randrange(256))) + draw.randbytes(30), draw.randrange(13)
                )
            case _:
                for _ in range(draw.randrange(1, 4)):
                    place = draw.choice([*range(4), *range(9, len(apdu))])  # all but the object's identifier
                    apdu[place] = draw.randrange(256)
                return datagram(bytes(apdu))

    async with served(episode_bus.endpoint) as (gateway, reader, port):
        instance = reader.objects[COOLING][1]
        counts, sent = gateway.counts, 0
        with raw_socket() as raw:
            while sent < FUZZED or min(counts.malformed, counts.rejected) <= 100:
                assert sent < 50 * FUZZED, f"{counts.malformed} malformed and {counts.rejected} rejected of {sent}"
                for _ in range(20):
                    raw.sendto(mutated(instance), ("127.0.0.1", port))
                sent += 20
                await asyncio.sleep(0)
        assert await patient_read(reader) == 0.0
        assert len(gateway._application.asap.serverTransactions) <= transactions.MAX_TRANSACTIONS
    assert {name for name, _ in commanded(episode_bus)} <= {COOLING}
    low, high = next((a.low, a.high) for a in episode_bus.manifest("office").actuators if a.name == COOLING)
    assert all(low <= value <= high for value in commanded(episode_bus).values())


async def patient_read(reader: Client) -> float:
    """Read the step; a device that is still busy with a flood aborts or answers late."""
    for _ in range(10):
        value = await reader.read(STEP)
        if isinstance(value, float):
            return value
    raise AssertionError(value)


@pytest.mark.slow
async def test_bacnet_gateway__flood_of_writes_is_answered_each_or_aborted_and_the_device_serves_others(
    episode_bus: Bus,
) -> None:
    async with served(episode_bus.endpoint) as (gateway, reader, port):
        instance = reader.objects[COOLING][1]
        with raw_socket() as raw:
            for invoke_id in range(200):
                request = write_request(instance, real(25.0 + invoke_id / 200), b"\x49\x08", invoke_id=invoke_id)
                raw.sendto(datagram(request), ("127.0.0.1", port))
            replies = {}
            while len(replies) < 200:
                message = await asyncio.to_thread(raw.recv, 2000)
                replies[message[7]] = (message[6] >> 4, message[-1])
        assert {kind for kind, _ in replies.values()} <= {2, ERROR, ABORT}
        accepted = [invoke_id for invoke_id, (kind, _) in replies.items() if kind == 2]
        assert {code for kind, code in replies.values() if kind == ABORT} <= {9}  # out-of-resources
        assert gateway.counts.writes == len(accepted) >= 1
        assert await patient_read(reader) == 0.0


async def test_bacnet_gateway__duplicate_of_a_request_is_carried_out_once(episode_bus: Bus) -> None:
    async with served(episode_bus.endpoint) as (gateway, reader, port):
        request = datagram(write_request(reader.objects[COOLING][1], real(26.0), b"\x49\x08"))
        with raw_socket() as raw:
            raw.sendto(request, ("127.0.0.1", port))
            raw.sendto(request, ("127.0.0.1", port))
            assert (await asyncio.to_thread(raw.recv, 2000))[6] >> 4 == 2
        assert await reader.read(COOLING) == 26.0
        assert gateway.counts.writes == 1


async def test_bacnet_gateway__client_that_dies_amid_a_segmented_request_or_with_subscriptions_costs_nothing(
    episode_bus: Bus,
) -> None:
    async with served(episode_bus.endpoint) as (gateway, reader, port):
        app = gateway._application
        app.asap.segmentTimeout = 100
        app.device_object.apduTimeout = app.asap.apduTimeout = 100
        with raw_socket() as raw:
            reply = await ask(raw, port, datagram(b"\x0c\x05\x01\x00\x04\x0f" + b"\x0c\x00"))
            assert reply[0] >> 4 == 4  # segment ack: the device waits for the next segment
        async with client(port) as dying:
            request = SubscribeCOVRequest(
                subscriberProcessIdentifier=1,
                monitoredObjectIdentifier=reader.identifier(STEP),
                issueConfirmedNotifications=True,
                destination=dying.device,
            )
            assert await dying.request(request) == "ok"
        async with asyncio.timeout(60):
            while app.asap.serverTransactions or app.asap.clientTransactions or app.is_subscribed(object):
                app.notify_subscribers()
                await asyncio.sleep(0.01)
        assert await reader.read(PAUSED) == "inactive"


async def test_bacnet_gateway__subscriptions_are_limited(episode_bus: Bus, monkeypatch) -> None:
    monkeypatch.setattr(services, "MAX_SUBSCRIPTIONS", 5)
    async with served(episode_bus.endpoint) as (_, reader, _):
        replies = [
            await reader.request(
                SubscribeCOVRequest(
                    subscriberProcessIdentifier=number,
                    monitoredObjectIdentifier=reader.identifier(STEP),
                    issueConfirmedNotifications=False,
                    lifetime=60,
                    destination=reader.device,
                )
            )
            for number in (*range(7), 0, 4)
        ]
        assert replies == ["ok"] * 5 + ["resources no-space-to-add-list-element"] * 2 + ["ok"] * 2, "two are renewed"
