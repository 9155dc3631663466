"""Programs that wait for the same node in one session: a wake-up of one of them is no message to another."""

import asyncio
import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress

import pytest
from support.nodes import NodeProgram, until

import zenostat
from zenostat import BuildingEnv, Bus
from zenostat.bridge.client import receive_watchdog
from zenostat.bridge.transport.wakeup import Wake
from zenostat.gateways.node_client import NodeClient
from zenostat.topics import keys
from zenostat.topics.errors import NodeLost, NodeNotFound, RequestRejected
from zenostat.topics.messages import Mode

Wait = Callable[[], int]
"""Waits for the sample after sample 0 and returns its step."""

CLAIMS: dict[str, list[str] | None] = {"controller": [], "env": None}
"""Actuators that those with a watchdog claim: an environment all, so a controller beside it none."""


@pytest.fixture
def wakes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Keys of all wake-ups of this process; a controller that waits for a sample is woken within milliseconds."""
    monkeypatch.setattr(receive_watchdog, "_FIRST_S", 0.01)
    monkeypatch.setattr(receive_watchdog, "_LONGEST_S", 0.02)
    woken: list[str] = []
    wake = Wake.__call__

    def record(self: Wake) -> None:
        woken.append(self.key)
        wake(self)

    monkeypatch.setattr(Wake, "__call__", record)
    return woken


@contextmanager
def waiter(bus: Bus, kind: str) -> Iterator[Wait]:
    """One program that has seen sample 0 of `office`, which is paused."""
    if kind == "listen":
        with bus.listen("office") as samples:
            yield lambda: next(samples).step
    elif kind in CLAIMS:
        with bus.controller("office", actuators=CLAIMS[kind]) as link:
            if kind == "env":
                env = BuildingEnv(link=link, reward=None)
                env.reset()
                yield lambda: int(env.step(env.action_space.sample())[-1]["step"])
            else:
                link.current()
                link.send()
                yield lambda: link.receive().step
    elif kind == "gateway":
        yield lambda: asyncio.run(_gateway(bus))
    else:
        yield lambda: _requests(bus)


async def _gateway(bus: Bus) -> int:
    async with NodeClient(bus.session, "office") as client:

        def is_next() -> bool:
            return client.sample is not None and client.sample.step > 0

        await client.wait_for(is_next, timeout_s=600, what="sample 1")
        assert client.sample is not None
        return client.sample.step


def _requests(bus: Bus) -> int:
    """Ask for everything that a node answers, again and again, until it has stepped."""
    while bus.status("office").step == [0]:
        assert bus.read("office").step >= 0
        assert len(bus.history("office", ["core_zn_air_temperature"])) >= 1
        bus.priorities("office")
        bus.weather("office", ["dry_bulb"])
        bus.alarms("office")
    return bus.status("office").step[0]


@contextmanager
def waiting(bus: Bus, wakes: list[str], kinds: tuple[str, ...]) -> Iterator[list[Future[int]]]:
    """All of them wait, and those with a watchdog have been woken several times."""
    order = sorted(kinds, key=lambda kind: kind != "env")  # first: its reset begins the episode
    with ExitStack() as stack, ThreadPoolExecutor(len(kinds)) as threads:
        waits = [stack.enter_context(waiter(bus, kind)) for kind in order]
        wakes.clear()
        futures = [threads.submit(wait) for wait in waits]
        watched = sum(kind in CLAIMS for kind in kinds)
        until(lambda: len(wakes) >= 5 * watched or any(f.done() for f in futures), "the watchdogs have woken them")
        try:
            yield futures
        finally:
            with suppress(NodeNotFound, RequestRejected):  # it was killed, or the test has resumed it
                bus.resume("office")  # whoever still waits gets samples


PAIRS = [*itertools.combinations(("controller", "env", "gateway", "listen", "requests"), 2)]
PAIRS += [(kind, kind) for kind in ("controller", "gateway", "listen")]


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_waiters__of_two_that_wait_for_a_paused_node_both_get_its_next_sample(
    episode_bus: Bus, wakes: list[str], kinds: tuple[str, ...]
) -> None:
    bus = episode_bus
    bus.pause("office")
    bus.pace("office", mode=Mode.FREE)
    with waiting(bus, wakes, kinds) as futures:
        assert not any(future.done() for future in futures), [f.exception() for f in futures if f.done()]
        bus.step("office")
        assert [future.result(60) for future in futures] == [1, 1]


@pytest.mark.slow
def test_waiters__strangers_message_to_the_key_of_a_wake_up_ends_nothing(episode_bus: Bus, wakes: list[str]) -> None:
    bus = episode_bus
    bus.pause("office")
    bus.pace("office", mode=Mode.FREE)
    with waiting(bus, wakes, ("listen", "controller")) as futures:
        last = int(wakes[-1].rpartition("-")[2])
        with zenostat.connect(bus.endpoint, affinity="off") as stranger:
            for number in range(1, last + 10):
                stranger.session.put(keys.wake("office", number), b"")
            stranger.status("office")
        bus.step("office")
        assert [future.result(60) for future in futures] == [1, 1]


@pytest.mark.slow
def test_waiters__all_that_wait_for_a_node_notice_its_loss(bus: Bus, node: NodeProgram, wakes: list[str]) -> None:
    bus.pause("office")
    bus.pace("office", mode=Mode.FREE)
    kinds = ("env", "controller", "gateway", "listen", "listen", "requests")
    with waiting(bus, wakes, kinds) as futures:
        assert not any(future.done() for future in futures)
        node.kill()
        for future in futures:
            with pytest.raises((NodeLost, NodeNotFound)):
                future.result(60)
