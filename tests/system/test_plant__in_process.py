"""A plant without engines, in the node's own process: everything that a node answers, it answers for this one too."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.in_process_plant import BUG, COPIES, FATAL
from support.nodes import NodeProgram, node_on_bus, until
from zenoh.handlers import RingChannel

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.bridge.client.bus import Bus
from zenostat.topics import codec, keys
from zenostat.topics.errors import ForkFailed, InvalidConfig, PlantFailed, RequestRejected, ZenostatError
from zenostat.topics.messages import Event, EventKind, Mode, State

TESTS = Path(__file__).parents[1]
STEPS = 20
SETTINGS = {"module": "support.in_process_plant", "name": "plain", "steps": STEPS}


@pytest.fixture
def plain(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place for a node, with the modules of the tests to be imported by its process."""
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}{os.pathsep}{TESTS.parent}")
    return scratch / "node"


@pytest.fixture
def node(plain: Path) -> Iterator[NodeProgram]:
    with NodeProgram(plain, **SETTINGS) as program:
        yield program


@pytest.fixture
def env(node: NodeProgram) -> Iterator[BuildingEnv]:
    with BuildingEnv(connect=node.endpoint, node="plain", reward=None, affinity="off") as environment:
        yield environment


def act(env: BuildingEnv, value: float) -> tuple[float, bool]:
    observation, _, _, truncated, _ = env.step(np.array([value], np.float32))
    return float(observation[0]), truncated


def test_plant__episode_through_gymnasium(env: BuildingEnv) -> None:
    """Each command acts within its step, and the last step of the run period is truncated."""
    env.reset(seed=0)
    results = [act(env, float(k)) for k in range(1, STEPS + 1)]
    assert results == [(float(k), k == STEPS) for k in range(1, STEPS + 1)]
    observation, info = env.reset()
    assert (observation[0], info["step"], info["engine_start"]) == (1.0, 0, "reset")


def test_plant__seeds(env: BuildingEnv) -> None:
    """A seed reaches the plant; without one the plant continues its own sequence."""
    assert [env.reset(seed=seed)[0][0] for seed in (7, None, None, 7)] == [7.0, 8.0, 9.0, 7.0]


def test_plant__relinquished_actuator_reaches_the_plant_as_nan(bus: Bus) -> None:
    """Its own control then applies: for this plant 0.0, and no effective value."""
    with bus.controller("plain") as link:
        sample = link.reset(seed=3)
        seen = [(sample["measured"], sample.effective.tolist())]
        for value in (4.0, None):
            sample.send({"command": value})
            sample = link.receive()
            seen.append((sample["measured"], sample.effective.tolist()))
    np.testing.assert_equal(seen, [(3.0, [np.nan]), (4.0, [4.0]), (0.0, [np.nan])])


def test_plant__snapshots_and_branches_are_refused_in_the_plants_words(env: BuildingEnv) -> None:
    """The episode continues after a refusal, and nothing of the copy remains in the status."""
    env.reset(seed=0)
    act(env, 4.0)
    with pytest.raises(ForkFailed, match=r"^this plant cannot be copied$"):
        env.snapshot()
    with pytest.raises(ForkFailed, match=r"^this plant cannot be copied$"):
        env.branch()
    assert act(env, 5.0) == (5.0, False)
    status = env.link.bus.status("plain", memory=True)
    assert (status.snapshots, status.branches, status.step) == ([], [], [2])


def test_plant__plant_that_can_be_copied_has_snapshots_and_branches(
    plain: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each continues from its sample, independent of the others, and each copy is closed in the end."""
    copies = scratch / "copies"
    copies.mkdir()
    monkeypatch.setenv(COPIES, str(copies))
    with (
        NodeProgram(plain, **SETTINGS) as node,
        BuildingEnv(connect=node.endpoint, node="plain", reward=None, affinity="off") as env,
    ):
        env.reset(seed=0)
        act(env, 4.0)
        with env.snapshot() as snapshot:
            with env.branch() as branch:
                assert (act(branch, 9.0), act(env, 5.0)) == ((9.0, False), (5.0, False))
                assert len([*copies.iterdir()]) == 2
            until(lambda: len([*copies.iterdir()]) == 1, "the branch's plant is closed")
            observation, info = env.reset(options={"snapshot": snapshot})
            assert (observation[0], info["step"], info["engine_start"]) == (4.0, 1, "snapshot")
        until(lambda: not [*copies.iterdir()], "the snapshot's plant is closed")


def test_plant__weather_is_refused(bus: Bus) -> None:
    with pytest.raises(RequestRejected, match="this plant has no weather"):
        bus.weather("plain", ["dry_bulb_temperature"])


def test_plant__status_and_manifest(bus: Bus, node: NodeProgram) -> None:
    """They describe a plant without weather, without engines and with a timestep of a second."""
    with bus.controller("plain") as link:
        sample = link.reset(seed=0)
        for value in (1.0, 2.0, 3.0):
            sample.send({"command": value})
            sample = link.receive()
        status = bus.status("plain", memory=True)
    assert (status.state, status.step, status.time, status.steps) == (
        State.WAITING, [3], ["2001-01-01T00:00:03"], STEPS,
    )  # fmt: skip
    assert (status.building, status.weather, status.mode) == ("empty", "", Mode.LOCKSTEP)
    assert (status.engine_rss_bytes, status.engine_private_bytes) == (0, 0)
    assert status.node_rss_bytes > 0
    manifest = bus.manifest("plain")
    assert (manifest.step_s, manifest.begin, manifest.end) == (1.0, "2001-01-01T00:00:00", "2001-01-01T00:00:20")
    assert [point.name for point in (*manifest.sensors, *manifest.actuators)] == ["measured", "command"]


def test_plant__its_error_fails_the_episode_and_a_reset_begins_another(env: BuildingEnv) -> None:
    env.reset(seed=0)
    with pytest.raises(PlantFailed, match=r"^the command 1313 broke the plant$"):
        act(env, FATAL)
    status = env.link.bus.status("plain")
    assert (status.state, status.failure_error) == (State.FAILED, "PlantFailed")
    env.reset(seed=2)
    assert act(env, 6.0) == (6.0, False)


def test_plant__slots_have_episodes_of_their_own(plain: Path) -> None:
    """A slot that is reset begins at its seed, and the other one keeps its sample and its command."""
    with (
        node_on_bus(plain, **SETTINGS, slots=2) as (_, bus),
        bus.controller("plain") as link,
        bus.session.declare_subscriber(keys.EVENT.at("plain"), RingChannel(100)) as events,
    ):
        link.reset(seed=5)
        link.send(np.array([[1.0], [2.0]]))
        sample = link.receive()
        assert np.frombuffer(sample.message.values).tolist() == [1.0, 2.0]
        sample = link.reset(seed=9, slots=[1])
        assert np.frombuffer(sample.message.values).tolist() == [1.0, 9.0]
        assert (sample.message.episode, sample.message.step) == ([1, 2], [1, 0])
        started: list[Event] = []
        until(lambda: _add(events, EventKind.STARTED, started) == 2, "both events have arrived")
        assert [(event.episode, event.step) for event in started] == [(1, 0), (2, 0)]
        assert started[1].text.startswith("episode 2 of empty begins in slot 1")


def _add(events: Any, kind: EventKind, known: list[Event]) -> int:
    """Add the events of a kind that have arrived, and return how many are known."""
    while (message := events.try_recv()) is not None:
        event = codec.decode(Event, message.payload.to_bytes())
        known += [event] if event.kind is kind else []
    return len(known)


def test_plant__baseline_that_the_plant_lacks_ends_the_start(plain: Path) -> None:
    with pytest.raises(InvalidConfig, match="the empty plant has no baseline"):
        NodeProgram(plain, **SETTINGS, baseline=True)


def test_plant__stop_request_ends_the_node(bus: Bus, node: NodeProgram) -> None:
    bus.stop("plain")
    assert node.process.wait() == 0


def test_request__internal_error_is_replied_reported_and_leaves_the_node_alive(env: BuildingEnv) -> None:
    bus, events = env.link.bus, keys.EVENT.at("plain")
    env.reset(seed=0)
    act(env, 4.0)
    with bus.session.declare_subscriber(events, RingChannel(100)) as subscriber:
        with pytest.raises(ZenostatError, match=r"^KeyError: 'weather'$"):
            bus.weather("plain", [f"{BUG}"])
        sent = until(subscriber.try_recv, "it is reported")
    event = codec.decode(Event, sent.payload.to_bytes())
    assert (event.kind, event.text) == (EventKind.WARNING, "rpc/weather: internal error: KeyError: 'weather'")
    assert act(env, 5.0) == (5.0, False)


def test_reset__internal_error_fails_the_episode_and_another_reset_begins_one(env: BuildingEnv) -> None:
    env.reset(seed=0)
    with pytest.raises(ZenostatError, match="KeyError: 'next_episode'"):
        env.reset(seed=BUG)
    status = env.link.bus.status("plain")
    assert (status.state, status.failure) == (State.FAILED, "KeyError: 'next_episode'")
    env.reset(seed=2)
    assert act(env, 6.0) == (6.0, False)


def test_faults__fault_that_a_changed_plan_keeps_goes_on(env: BuildingEnv) -> None:
    bus, drift = env.link.bus, {"kind": "drift", "points": "measured", "rate_per_h": 3600.0}  # 1 per timestep
    frozen = {"kind": "freeze", "actuators": "command", "when": {"from_step": 3}}
    noise, bias = (
        {"kind": "noise", "name": "noise", "points": "measured", "sigma": 1.0},
        {"kind": "bias", "name": "bias", "points": "measured", "offset": 100.0, "when": {"from_step": 8}},
    )

    def play(*plans: list[dict[str, object]]) -> list[float]:
        seen, pending = [env.reset(seed=0)[0][0]], dict(enumerate(plans))
        for step in range(12):
            if step % 5 == 0 and (faults := pending.pop(step // 5, None)) is not None:
                bus.faults("plain", {"faults": faults})
            seen.append(act(env, float(step))[0])
        bus.faults("plain", {"faults": []})
        return seen

    expected = play([drift, frozen, noise])
    assert expected[11] == pytest.approx(3.0 + 11.0, abs=6.0)
    changed = play([drift, frozen, noise], [bias, noise, drift, frozen], [noise, frozen, drift])
    assert changed[:8] == expected[:8]
    assert changed[8:11] == pytest.approx([value + 100.0 for value in expected[8:11]])
    assert changed[11:] == expected[11:]


def test_faults__day_that_does_not_exist_is_refused_and_the_present_faults_stay(env: BuildingEnv) -> None:
    bus = env.link.bus
    env.reset(seed=0)
    bus.faults("plain", {"faults": [{"kind": "bias", "name": "stays", "points": "measured", "offset": 1.0}]})
    leap = {"kind": "bias", "points": "measured", "offset": 1.0, "when": {"from_time": "02-29T00:00"}}
    with pytest.raises(InvalidConfig, match=r"fault 'bias 1': '02-29T00:00' does not exist in 2001"):
        bus.faults("plain", {"faults": [leap]})
    assert bus.fault_plan("plain").names == ("stays",)
    assert act(env, 5.0) == (6.0, False)
