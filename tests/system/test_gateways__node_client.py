"""One node in a gateway's asyncio program: real nodes, which end, return and are asked too much."""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from zenostat import Bus
from zenostat.bridge.transport.session import open_session
from zenostat.gateways import node_client
from zenostat.gateways.node_client import NodeClient
from zenostat.topics.errors import InvalidAction, InvalidConfig, RequestRejected, UnknownName
from zenostat.topics.messages import Event, EventKind

COOLING = "core_zn_cooling_setpoint"


@asynccontextmanager
async def _client(endpoint: str, **options: Any) -> AsyncIterator[NodeClient]:
    with open_session(connect=[endpoint]) as session:
        async with NodeClient(session, "office", **options) as client:
            yield client


async def test_gateways__paused_node_steps_on_command_and_a_write_takes_effect(episode_bus: Bus) -> None:
    episode_bus.pause("office")
    episode_bus.pace("office", mode="free")
    events: list[Event] = []
    async with _client(episode_bus.endpoint, source="device-7") as node:
        node.listeners.events.append(events.append)
        begin = node.sample
        assert begin.step == 0
        after = await node.step(2)
        assert (after.episode, after.step) == (begin.episode, 2)
        assert after.time - begin.time == 2 * node.manifest.timestep
        ack = await node.write(COOLING, 26.5)
        assert "26.5" in ack.text
        arrays = await node.priorities()
        assert [(p, *entry) for p, entry in enumerate(arrays[COOLING], 1) if entry.value is not None] == [
            (8, 26.5, "device-7")
        ]
        effective = (await node.step()).effective
        assert effective[[a.name for a in node.manifest.actuators].index(COOLING)] == 26.5
        for bad, error in (
            ({"value": 99.0}, RequestRejected),
            ({"value": float("nan")}, InvalidAction),
            ({"value": 25.0, "priority": 17}, InvalidAction),
            ({"value": 25.0, "duration_s": -1.0}, InvalidAction),
        ):
            with pytest.raises(error, match=COOLING):
                await node.write(COOLING, **bad)
        with pytest.raises(UnknownName, match="did you mean"):
            await node.write("core_zn_coling_setpoint", 26.0)
        assert (node.counts.writes, node.counts.rejected) == (1, 5)
        await node.write(COOLING, None)
        await node.resume()
        with pytest.raises(RequestRejected, match="not paused"):
            await node.step()
    assert [event.source for event in events if event.kind is EventKind.WRITTEN] == ["device-7"] * 2


@pytest.mark.parametrize("name", ["*", "**", "offic*", "off#ce"])
def test_gateways__wildcard_is_no_node(name: str) -> None:
    session: Any = None  # not used
    with pytest.raises(InvalidConfig, match=re.escape(f"the node's name {name!r} is not valid")):
        NodeClient(session, name)


async def test_gateways__commands_are_relinquished_although_one_of_them_cannot_be(episode_bus: Bus) -> None:
    names = sorted(("core_zn_heating_setpoint", COOLING))
    async with _client(episode_bus.endpoint, source="device-7") as node:
        for name in names:
            await node.write(name, 22.0 if name == names[1] else 24.0)
        with episode_bus.controller("office", name="mine", priority=8, actuators=names[:1], required=False):
            done = await node.relinquish_written()
    assert (done.count, [*done.rejected]) == (1, [(names[0], 8, "device-7")])
    assert all("is claimed by 'mine" in reason for reason in done.rejected.values())
    arrays = episode_bus.priorities("office")
    assert [arrays[name][7].value for name in names] == [24.0, None]


async def test_gateways__commands_of_others_under_the_name_of_a_client_are_not_relinquished(episode_bus: Bus) -> None:
    async with (
        _client(episode_bus.endpoint, source="mqtt") as node,
        _client(episode_bus.endpoint, source="mqtt2") as other,
    ):
        for value, client in ((26.0, node), (25.0, other)):
            await client.write(COOLING, value, source="node-red")
        assert (await node.relinquish_written()).count == 0
        assert episode_bus.priorities("office")[COOLING][7] == (25.0, "mqtt2.node-red")
        episode_bus.write("office", COOLING, 24.0, source="node-red")
        assert (await other.relinquish_written()).count == 0
    assert episode_bus.priorities("office")[COOLING][7] == (24.0, "node-red")


@pytest.mark.slow
async def test_gateways__node_in_lockstep_without_its_controller_ends_the_wait_for_a_step(episode_bus: Bus) -> None:
    episode_bus.pause("office")
    async with _client(episode_bus.endpoint) as node:
        with pytest.raises(RequestRejected, match="did not reach sample 1 within"):
            await node.step(timeout_s=0.2)


async def test_gateways__too_many_requests_at_once_are_rejected_and_the_others_answered(
    episode_bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node_client, "MAX_PENDING", 10)

    async with _client(episode_bus.endpoint) as node:
        writes = [node.write(COOLING, 25.0 + 0.01 * i) for i in range(30)]
        replies = await asyncio.gather(*writes, return_exceptions=True)
    rejected = [reply for reply in replies if isinstance(reply, RequestRejected)]
    assert len(rejected) == 20
    assert all("10 requests" in str(reply) for reply in rejected)
    assert len([reply for reply in replies if not isinstance(reply, Exception)]) == 10
