"""Samples and events that are lost on the way, and large messages of strangers, which once displaced them."""

import re
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
import zenoh
from support.contract_page import PAGE
from support.nodes import NodeProgram, Program, engines_of, until, values_of_day

import zenostat
from zenostat import Bus
from zenostat.bridge.client import controller_link, receive_watchdog
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.transport.session import open_session
from zenostat.gateways.node_client import NodeClient
from zenostat.topics import codec, keys
from zenostat.topics.errors import EngineDied, EpisodeChanged, RequestRejected
from zenostat.topics.messages import Event, EventKind, Reset, Sample, State, Status

POINT = "core_zn_cooling_setpoint"

FLOOD = """
import sys, time
import zenoh
from zenostat.bridge.transport.session import open_session
from zenostat.topics import codec
with open_session(connect=[sys.argv[1]]) as session:
    print("floods", flush=True)
    while True:
        priority = getattr(zenoh.Priority, sys.argv[2])
        session.put("zenostat/v3/office/nothing", bytes(codec.MAX_BYTES), priority=priority)
        time.sleep(float(sys.argv[3]))
"""


SUBSCRIBES_TO_ALL_AND_READS_NOTHING = """
import sys
from zenostat.bridge.transport.session import open_session
with open_session(connect=[sys.argv[1]]) as session:
    subscriber = session.declare_subscriber("zenostat/**")  # its queue holds 256 messages
    print("subscribes", flush=True)
    sys.stdin.readline()
"""


def lose(link: ControllerLink, is_lost: Callable[[str, bytes], bool]) -> list[str]:
    """Discard messages of the link's inbox as if Zenoh had dropped them; return the list of their keys."""
    lost: list[str] = []

    def without_lost(receive: Callable[[], Any]) -> Callable[[], Any]:
        def receive_next() -> Any:
            while True:
                message = receive()
                if message is None or not is_lost(key := str(message.key_expr), message.payload.to_bytes()):
                    return message
                lost.append(key)

        return receive_next

    link._recv, link._try_recv = without_lost(link._recv), without_lost(link._try_recv)
    return lost


def is_sample(step: int) -> Callable[[str, bytes], bool]:
    return lambda key, payload: key.endswith("/sample") and codec.decode(Sample, payload).step == [step]


def is_event(kind: EventKind) -> Callable[[str, bytes], bool]:
    return lambda key, payload: key.endswith("/event") and codec.decode(Event, payload).kind is kind


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("step", [40, 0, 96])
def test_lost_sample__is_requested(episode_bus: Bus, step: int) -> None:
    with episode_bus.controller("office") as link:
        quiet = values_of_day(link)
        lost = lose(link, is_sample(step))
        assert values_of_day(link) == quiet
    assert lost == [keys.SAMPLE.at("office")]


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["command", "sample"])
def test_lost_messages__program_of_the_contract_goes_on(
    episode_bus: Bus, capsys: pytest.CaptureFixture[str], lost: str
) -> None:
    text = PAGE.read_text(encoding="utf-8").partition("## A complete controller")[2]
    code = re.search(r"```python\n(.*?)```", text, re.S)
    assert code is not None
    program = code[1].replace("tcp/127.0.0.1:7447", episode_bus.endpoint)
    steps: list[int] = []

    def put(session: zenoh.Session, key: str, payload: bytes, **options: Any) -> None:
        (step,) = msgpack.unpackb(payload)["step"]
        steps.append(step)
        if lost == "sample" or step != 40 or steps.count(40) > 1:
            session.put(key, payload, **options)

    def without_lost(put: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], None]:
        def put_others(message: zenoh.Sample) -> None:
            if lost == "command" or not is_sample(40)(str(message.key_expr), message.payload.to_bytes()):
                put(message)

        return put_others

    program = program.replace("session.put(", "put(session, ").replace("inbox.put", "without_lost(inbox.put)")
    exec(program, {"put": put, "without_lost": without_lost})
    assert capsys.readouterr().out.startswith("[96] ")
    assert sorted({*steps}) == [*range(96)]
    assert steps.count(40) >= (2 if lost == "command" else 1)


@pytest.mark.slow
def test_lost_messages__controller_that_connects_late_asks_for_the_sample_after_the_one_that_is_answered(
    episode_bus: Bus,
) -> None:
    """The node waits for another controller at sample 0, of which this one does not know whether it has answered."""
    with episode_bus.controller("office", actuators=[POINT], name="a") as first:
        others = [a.name for a in first.manifest.actuators if a.name != POINT]
        with episode_bus.controller("office", actuators=others, name="b") as second:
            assert first.current().step == second.current().step == 0
            lost = lose(second, is_sample(1))
            for link in (first, second):
                link.send()
            assert [first.receive().step, second.receive().step] == [1, 1]
            assert lost


@pytest.mark.slow
def test_lost_messages__failure_whose_event_is_lost_is_raised(bus: Bus, node: NodeProgram) -> None:
    with bus.controller("office") as link:
        link.reset()
        lost = lose(link, is_event(EventKind.FAILED))
        for engine in engines_of(node.pid):
            engine.kill()
        link.send()
        with pytest.raises(EngineDied, match="SIGKILL"):
            link.receive()
        assert link.reset().step == 0, "another episode starts"
    assert lost


@pytest.mark.slow
def test_lost_messages__reset_by_another_controller_is_raised_though_its_messages_are_lost(episode_bus: Bus) -> None:
    with episode_bus.controller("office", actuators=[POINT]) as link:
        link.reset()
        link.send()
        link.receive()
        lost = lose(link, lambda key, _: key.rpartition("/")[2] in ("sample", "event"))
        with episode_bus.controller("office", actuators=[], required=False) as other:
            other.reset()
        with pytest.raises(EpisodeChanged, match="was reset by another controller"):
            link.receive()
    assert lost


@pytest.mark.slow
def test_lost_messages__controller_that_receives_nothing_for_long_gets_replies_and_the_latest_samples(
    episode_bus: Bus,
) -> None:
    """More samples than its inbox holds come from another controller's episodes."""
    with (
        episode_bus.controller("office", actuators=[], required=False) as link,
        zenostat.connect(episode_bus.endpoint, affinity="off") as elsewhere,
        elsewhere.controller("office") as other,
    ):
        link.current()
        for _ in range(12):
            values_of_day(other)
        status = episode_bus.status("office")
        assert status.state is State.ENDED
        with pytest.raises(EpisodeChanged):
            link.receive()
        sample = link.reset()
        assert (sample.step, sample.episode) == (0, status.episode[0] + 1)
        other.reset()
        with pytest.raises(EpisodeChanged):
            link.receive()


def test_lost_messages__controller_without_a_claim_does_not_wait_for_ever() -> None:
    """A rule, with a bus of its own: nobody waits for a controller that the node does not know."""

    class OneSample:
        def latest(self, _: str) -> str:
            return "sample"

        def status(self, _: str) -> Any:
            return Status.model_construct(state=State.WAITING, controllers=[])

    with pytest.raises(RequestRejected, match="node 'office' has no claim of 'c' any more"):
        receive_watchdog.query_sample(OneSample(), "office", "c")  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("priority", ["DATA", "REAL_TIME"])
def test_lost_messages__large_messages_of_a_stranger_do_not_displace_samples(
    episode_bus: Bus, monkeypatch: pytest.MonkeyPatch, priority: str
) -> None:
    """At Zenoh's default priority none is lost; at a higher one than the samples', which are lost is asked for."""
    regained: list[int] = []

    with episode_bus.controller("office") as link:

        def ask(*arguments: Any) -> Sample | None:
            sample = receive_watchdog.query_sample(*arguments)
            if sample is not None and link._latest is not None and sample.step > link._latest.message.step:
                regained.extend(sample.step)
            return sample

        monkeypatch.setattr(controller_link, "query_sample", ask)
        quiet = values_of_day(link)
        with Program(FLOOD, episode_bus.endpoint, priority, "0.02" if priority == "DATA" else "0.3") as flood:
            assert flood.line() == "floods"
            assert values_of_day(link) == quiet
    assert not regained or priority != "DATA"


@pytest.mark.slow
def test_lost_messages__subscriber_to_everything_that_reads_nothing_delays_commands_once_and_is_disconnected(
    episode_bus: Bus,
) -> None:
    """Commands are not dropped, and `**` includes them; Zenoh gives it five seconds."""
    with episode_bus.controller("office") as link:
        quiet = values_of_day(link)
        with Program(SUBSCRIBES_TO_ALL_AND_READS_NOTHING, episode_bus.endpoint) as program:
            assert program.line() == "subscribes"
            for _ in range(5):
                assert values_of_day(link) == quiet


@pytest.mark.slow
def test_lost_messages__refusals_of_strangers_leave_room_for_those_of_a_controller(episode_bus: Bus) -> None:
    """More than are published in a step; the controller's own is, or it would wait for a sample that never comes."""
    with episode_bus.controller("office") as link, open_session(connect=[episode_bus.endpoint]) as session:
        link.reset()
        for _ in range(60):
            session.put(keys.ACTUATOR.at("office", name=POINT, sender="panel"), msgpack.packb({"value": "x"}))
            session.put(keys.COMMAND.at("office", sender="stranger"), b"\xc1")
        until(lambda: episode_bus.status("office").rejected >= 120, "all of them are refused")
        link.send(np.full(len(link.manifest.actuators), 99.0))
        with pytest.raises(RequestRejected, match="= 99; its bounds are"):
            link.receive()


@pytest.mark.slow
async def test_lost_messages__gateway_asks_for_a_lost_sample(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    bus.pause("office")
    bus.pace("office", mode="free")
    bus.reset("office", Reset())
    with open_session(connect=[bus.endpoint]) as session:
        async with NodeClient(session, "office") as client:
            handle = client._handle
            monkeypatch.setattr(client, "_handle", lambda m: m.key.endswith("/sample") or handle(m))
            assert (await client.step(3)).step == 3
