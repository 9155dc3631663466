"""Bursts of messages that a node receives while it is busy: the newest of each key wait, and the others are counted."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from support.nodes import until

from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.node.waiting import MAX_PENDING
from zenostat.bridge.transport.session import open_session
from zenostat.topics import keys

FURTHER = 40


@pytest.fixture
def subscriptions(folder: Path) -> Iterator[tuple[Subscriptions, zenoh.Session]]:
    """Those of a node, and the session of a client."""
    endpoint = f"unixsock-stream/{folder}/bus"
    with (
        open_session(listen=[endpoint]) as node,
        open_session(connect=[endpoint]) as client,
        Subscriptions(node, "office") as own,
    ):
        yield own, client


@pytest.mark.process
def test_subscriptions__burst_leaves_the_newest_message_of_each_point(
    subscriptions: tuple[Subscriptions, zenoh.Session],
) -> None:
    own, client = subscriptions
    handled, reports = list[tuple[str, bytes]](), list[tuple[str, str]]()
    own.listen(keys.ACTUATOR, lambda _sender, name, payload, _encoding: handled.append((name, payload)))
    own.on_dropped = lambda text, sender: reports.append((text, sender))
    valve, pump = (keys.ACTUATOR.at("office", name=name, sender="panel") for name in ("valve", "pump"))
    publisher = client.declare_publisher(valve, congestion_control=zenoh.CongestionControl.BLOCK)
    until(lambda: publisher.matching_status.matching, "the client knows of the subscriber")
    client.put(pump, b"once", congestion_control=zenoh.CongestionControl.BLOCK)
    for number in range(MAX_PENDING + FURTHER):  # one more than fits each time, since the pump's waits as well
        publisher.put(str(number).encode())
    until(lambda: own.rate_limited == FURTHER + 1, "all have arrived")
    until(lambda: own.run_pending() or reports, "all that wait are handled")
    assert handled[0] == ("pump", b"once")
    assert [int(payload) for _, payload in handled[1:]] == [*range(FURTHER + 1, MAX_PENDING + FURTHER)]
    ((text, sender),) = reports
    assert text.endswith(
        f"{FURTHER + 1} messages dropped (valve), older ones before newer ones of the same key, since 256 were waiting"
    )
    assert sender == "panel"


@pytest.mark.process
def test_subscriptions__only_message_of_a_key_stays_in_a_flood_of_another(
    subscriptions: tuple[Subscriptions, zenoh.Session],
) -> None:
    own, client = subscriptions
    handled, reports = list[str](), list[tuple[str, str]]()
    own.listen(keys.ACTUATOR, lambda sender, name, _payload, _encoding: handled.append(f"{sender}/{name}"))
    own.on_dropped = lambda text, sender: reports.append((text, sender))
    valve = keys.ACTUATOR.at("office", name="valve", sender="flooder")
    pump = keys.ACTUATOR.at("office", name="pump", sender="panel")
    publisher = client.declare_publisher(valve, congestion_control=zenoh.CongestionControl.BLOCK)
    until(lambda: publisher.matching_status.matching, "the client knows of the subscriber")
    for _ in range(MAX_PENDING):
        publisher.put(b"x")
    client.put(pump, b"x", congestion_control=zenoh.CongestionControl.BLOCK)
    until(lambda: own.rate_limited == 1, "all have arrived")
    until(lambda: own.run_pending() or reports, "all that wait are handled")
    assert handled == [*["flooder/valve"] * (MAX_PENDING - 1), "panel/pump"]
    ((text, sender),) = reports
    assert "1 message dropped (valve)" in text
    assert sender == "flooder"
