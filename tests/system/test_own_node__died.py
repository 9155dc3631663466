"""An environment whose own node died starts another one at its next reset, and says why."""

import re
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import psutil
import pytest
from support.nodes import SMALL, until

import zenostat
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics.errors import EpisodeChanged, InvalidConfig, InvalidRecording, NodeLost, NodeNotFound
from zenostat.topics.messages import RecordingState

pytestmark = pytest.mark.usefixtures("scratch")

VECTOR = "vector_entry_point"
STARTED = r"own node had ended \(killed by SIGKILL.*\), and another one was started"


def kill_node(env: Any) -> None:
    node = psutil.Process(env.unwrapped.local_node.pid)
    node.kill()
    with pytest.raises(NodeLost, match="is gone"):
        step_for_ever(env)


def step_for_ever(env: Any) -> None:
    while True:
        env.step(env.action_space.sample())


@pytest.mark.slow
def test_own_node__single_environment() -> None:
    env = gym.make("zenostat/Building-v1", **SMALL, affinity="off")
    first, _ = env.reset(seed=7)
    action = env.action_space.sample()
    stepped = env.step(action)[0]
    snapshot = env.unwrapped.snapshot()
    instance = env.unwrapped.manifest.instance
    kill_node(env)
    with pytest.warns(UserWarning, match=STARTED), pytest.raises(InvalidConfig, match="was restarted"):
        env.reset(options={"snapshot": snapshot})
    again, _ = env.reset(seed=7)
    assert env.unwrapped.manifest.instance != instance
    assert np.array_equal(first, again)
    assert np.array_equal(env.step(action)[0], stepped)
    env.close()


@pytest.mark.slow
def test_own_node__each_of_its_nodes_has_a_recording(scratch: Path) -> None:
    """The recording of the node that died is kept, and verifies up to its end."""
    paths = [scratch / name for name in ("run.mcap", "run-3.mcap", "run-4.mcap")]
    (scratch / "run-2.mcap").write_text("not mine")
    env = gym.make("zenostat/Building-v1", **SMALL, affinity="off", record=paths[0])
    for number, path in enumerate(paths):
        if number:
            psutil.Process(env.unwrapped.local_node.pid).kill()
            with pytest.warns(UserWarning, match=rf"another one was started; it records to {re.escape(str(path))};"):
                env.reset(seed=number)
        else:
            env.reset(seed=number)
        for _ in range(5):
            env.step(env.action_space.sample())
        until(lambda path=path: samples_in(path) >= 6, "the chunk is written")
    env.close()
    assert (scratch / "run-2.mcap").read_text() == "not mine"
    for path in paths:
        result = verify(path)
        assert result.passed, str(result)
        assert result.steps == 5


def samples_in(path: Path) -> int:
    with suppress(InvalidRecording), RecordingReader(path) as reader:
        return sum(1 for _ in reader.messages({"Sample"}))
    return 0


@pytest.mark.slow
def test_own_node__it_dies_again_and_again() -> None:
    env = gym.make("zenostat/Building-v1", **SMALL, affinity="off")
    for _ in range(2):
        env.reset()
        psutil.Process(env.unwrapped.local_node.pid).kill()  # the reset follows at once
        with pytest.warns(UserWarning, match=STARTED):
            env.reset()
        env.step(env.action_space.sample())
    env.close()


@pytest.mark.slow
def test_own_node__vector_environment() -> None:
    env = gym.make_vec("zenostat/Building-v1", 2, "vector_entry_point", **SMALL, affinity="off")
    first, _ = env.reset(seed=7)
    kill_node(env)
    with pytest.warns(UserWarning, match=STARTED) as caught, pytest.raises(EpisodeChanged, match="all slots"):
        env.reset(options={"reset_mask": np.array([True, False])})
    assert caught[0].filename == __file__
    again, _ = env.reset(seed=7)
    assert np.array_equal(first, again)
    env.step(env.action_space.sample())
    env.close()


@pytest.mark.slow
def test_own_node__node_of_another_process_is_not_started_again() -> None:
    own = gym.make("zenostat/Building-v1", **SMALL, affinity="off")
    node = own.unwrapped.local_node
    env = gym.make("zenostat/Building-v1", connect=node.endpoint, node="building", priority=9, affinity="off")
    env.reset()
    psutil.Process(node.pid).kill()
    with pytest.raises(NodeLost, match="is gone"):
        step_for_ever(env)
    with pytest.raises(NodeNotFound, match="no node 'building'"):
        env.reset()
    env.close()
    own.close()


@pytest.mark.slow
@pytest.mark.parametrize("slots", [1, 2])
def test_own_node__recording_that_stops_is_a_warning(slots: int, scratch: Path) -> None:
    path = scratch / "run.mcap"
    settings: dict[str, Any] = {**SMALL, "affinity": "off", "record": str(path)}
    make: Any = gym.make if slots == 1 else partial(gym.make_vec, num_envs=slots, vectorization_mode=VECTOR)
    for on_reset in (True, False):
        env = make("zenostat/Building-v1", **settings)
        env.reset(seed=1)
        let_recording_stop(env, path)
        with pytest.warns(UserWarning, match=rf"the recording to {re.escape(str(path))} stopped: cannot write"):
            env.reset() if on_reset else env.close()
        env.close()  # it warns once
        assert not psutil.pid_exists(env.unwrapped.local_node.pid)
        path.unlink()


def let_recording_stop(env: Any, path: Path) -> None:
    """Let the file not grow any more, which is what a full disk does, and step until the node has noticed."""
    node = env.unwrapped.local_node
    with zenostat.connect(node.endpoint, affinity="off") as bus:
        until(lambda: bus.status("building").recording.messages, "the first chunk is written")
        process = psutil.Process(node.pid)
        _, hard = process.rlimit(psutil.RLIMIT_FSIZE)
        process.rlimit(psutil.RLIMIT_FSIZE, (path.stat().st_size + 1000, hard))
        for _ in range(50):
            env.step(env.action_space.sample())
        until(lambda: bus.status("building").recording.state is RecordingState.STOPPED, "it has stopped")
