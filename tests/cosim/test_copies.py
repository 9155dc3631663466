"""Snapshots, branches and trials of whole districts: to the bit, and of all plants or none."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.district_files import DISTRICT, write_district

import zenostat  # noqa: F401  # registers the environments
from zenostat.topics.errors import ForkFailed, RequestRejected

ACTIONS = np.random.default_rng(1).uniform([0, 0, -4000, 0], [4000, 4000, 4000, 11000], (10, 4)).astype(np.float32)


@pytest.fixture(scope="module")
def env(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    text = DISTRICT.replace('"plants.py:House"', '"plants.py:House", branches: 6')
    file = write_district(tmp_path_factory.mktemp("district"), text)
    with gym.make("zenostat/District-v1", file=file) as created:
        yield created.unwrapped


def steps(env: Any, first: int, count: int) -> list[bytes]:
    """The samples and rewards of some timesteps, raw."""
    bits = []
    for action in ACTIONS[first : first + count]:
        _, reward, *_ = env.step(action)
        bits += [env.sample.message.values, env.sample.message.effective, np.float64(reward).tobytes()]
    return bits


@pytest.mark.slow
def test_district_copies__snapshot_is_returned_to_and_goes_on_to_the_bit(env: Any) -> None:
    env.reset(seed=4)
    steps(env, 0, 3)
    with env.snapshot() as snapshot:
        straight = steps(env, 3, 4)
        env.reset(options={"snapshot": snapshot})
        assert env.sample.step == 3
        assert steps(env, 3, 4) == straight
        env.reset(seed=5)
        steps(env, 0, 1)
        env.reset(options={"snapshot": snapshot})
        assert steps(env, 3, 7)[: len(straight)] == straight


@pytest.mark.slow
def test_district_copies__branches_do_not_touch_the_episode(env: Any) -> None:
    env.reset(seed=4)
    steps(env, 0, 2)
    with env.snapshot() as snapshot, env.branch() as branch, env.branch() as other:
        ahead = steps(branch, 2, 8)
        steps(other, 5, 2)
        assert env.sample.step == 2
        assert steps(env, 2, 8) == ahead
        with env.branch(snapshot=snapshot) as again:
            assert steps(again, 2, 3) == ahead[:9]


@pytest.mark.slow
def test_district_copies__trial_is_the_step_that_follows(env: Any) -> None:
    env.reset(seed=2)
    steps(env, 0, 2)
    tried = env.try_step(ACTIONS[2:5])
    assert len({sample.message.values for sample in tried}) == 3
    env.step(ACTIONS[3])
    assert env.sample.message.values == tried[1].message.values


def test_district_copies__stepped_branch_tries_steps(env: Any) -> None:
    """Each trial is the step that follows, to the bit, and the branch goes on as if there had been none."""
    env.reset(seed=2)
    steps(env, 0, 1)
    straight = steps(env, 1, 4)
    env.reset(seed=2)
    steps(env, 0, 1)
    with env.branch() as branch:
        taken = steps(branch, 1, 2)
        tried = branch.try_step(ACTIONS[3:5])
        taken += steps(branch, 3, 2)
    assert taken == straight
    assert tried[0].message.values == straight[6]
    assert len({sample.message.values for sample in tried}) == 2


def test_district_copies__branch_of_a_branch_is_refused_with_what_to_do(env: Any) -> None:
    env.reset(seed=2)
    expected = f"no snapshots, branches or recordings; ask its node {env.manifest.node!r}"
    with env.branch() as branch:
        steps(branch, 0, 1)
        with pytest.raises(RequestRejected, match=expected):
            branch.branch()


def test_district_copies__plans_are_the_rewards_of_the_steps(env: Any) -> None:
    env.reset(seed=2)
    steps(env, 0, 2)
    planned = env.plan(ACTIONS[None, 2:6])
    rewards = [env.step(action)[1] for action in ACTIONS[2:6]]
    assert planned[0].tolist() == rewards


def test_district_copies__nothing_is_left_behind(env: Any) -> None:
    """The nodes of the plants have no snapshots once those of the district are closed."""
    env.reset(seed=2)
    for _ in range(8):  # more than the nodes of the houses allow at a time
        env.snapshot().close()


@pytest.mark.slow
def test_district_copies__plant_that_cannot_be_copied_is_named(tmp_path: Path) -> None:
    file = write_district(
        tmp_path, DISTRICT.replace('west: {plant: "plants.py:House"', 'west: {plant: "plants.py:Uncopied"')
    )
    with gym.make("zenostat/District-v1", file=file) as created:
        created.reset(seed=0)
        for _ in range(66):  # more than the other nodes allow at a time
            with pytest.raises(ForkFailed, match=r"plant 'west' has no snapshot: .*; the others have none either"):
                created.unwrapped.snapshot()
        created.step(ACTIONS[0])


@pytest.mark.slow
def test_district_copies__district_in_the_loop_of_another_district(tmp_path: Path) -> None:
    """The inner district is copied for the trials of the outer one's loop."""
    write_district(tmp_path)
    (tmp_path / "outer.yaml").write_text(
        "name: outer\n"
        "plants:\n"
        "  quarter: {district: district.yaml}\n"
        "connections:\n"
        "  - {from: quarter.feeder.import, to: quarter.feeder.battery_setpoint, factor: -0.5, solve: true, "
        "tolerance: 0.5}\n"
    )
    with gym.make("zenostat/District-v1", file=tmp_path / "outer.yaml", reward=None) as created:
        created.reset(seed=1)
        for _ in range(3):
            created.step(np.array([1000.0, 1000.0, 2000.0], np.float32))
            sample = created.unwrapped.sample
            net_w = sample["quarter.feeder.import"] - sample["quarter.feeder.export"]
            assert sample["loop.quarter.solved"] == 1.0
            assert net_w > 0.0
            assert sample["exchange.quarter.feeder.import-quarter.feeder.battery_setpoint"] == pytest.approx(
                -0.5 * net_w, abs=0.5
            )
