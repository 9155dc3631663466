"""The engine pool under failures: where the engine of an episode comes from, and which weather it has."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from support.engine_forks import FOUR, SMALL, Faults, engines, episode, go, make, plan, same
from support.nodes import SMALL as OFFICE
from support.nodes import runs, until

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.runtime.idle_watch import IdleWatch
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.engine_pool import EnginePool
from zenostat.eplus_node.fork_template import EngineTemplate
from zenostat.eplus_node.plan import Plan
from zenostat.eplus_node.plan import plan as read_plan
from zenostat.models.catalog import find_weather
from zenostat.models.scenario.episode_weather import WeatherDraw, WeatherSampler
from zenostat.topics.errors import EngineDied, ForkFailed, SimulatorError
from zenostat.topics.messages import EngineStart, State

STOCHASTIC = SMALL.replace("continuous", "continuous-stochastic")
IN_TURN = {"weather": ["USA_CO_Denver", "USA_FL_Miami"], "weather_order": "sequence"}


@contextmanager
def no_room(env: Any) -> Iterator[None]:
    """Replace the folder for the engines' files by a file."""
    folder = env.local_node.folder
    aside = folder.with_name(f"{folder.name}-aside")
    folder.rename(aside)
    folder.touch()
    try:
        yield
    finally:
        folder.unlink()
        aside.rename(folder)


@pytest.mark.slow
@pytest.mark.parametrize("times", [2, 3])
@pytest.mark.parametrize("arguments", [IN_TURN | {"name": SMALL}, {"name": STOCHASTIC}], ids=["in turn", "noise"])
def test_seed__repeated_at_once_begins_the_same_sequence(scratch: Path, arguments: dict[str, Any], times: int) -> None:
    """No weather and no noise is drawn twice or skipped."""

    def drawn(env: Any, seeds: list[int | None]) -> list[Any]:
        weather = []
        for seed in seeds:
            _, info = env.reset(seed=seed)
            weather.append((info["weather"], info["weather_noise"]))
            if seed is None:
                env.step([20.0, 25.0])
        return weather

    env, again = make(**arguments), make(**arguments)
    expected = drawn(env, [5, None, None, None])
    assert drawn(again, [5] * times + [None] * 3)[times - 1 :] == expected
    env.close()
    again.close()


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(("name", "error"), [(SMALL, ForkFailed), (STOCHASTIC, EngineDied)])
def test_reset__without_room_for_files_fails_and_recovers(
    scratch: Path, name: str, error: type[SimulatorError]
) -> None:
    env = make(name, **FOUR)
    mine = plan(env, 1)
    straight = episode(env, mine, seed=4)
    for _ in range(2):
        with no_room(env), pytest.raises(error, match="cannot prepare"):
            env.reset(seed=9)
        assert env.link.bus.status("building").state is State.FAILED
    same(episode(env, mine, seed=4), straight)
    env.close()


@pytest.mark.slow
def test_prefetch__that_fails_starts_the_engine_at_the_reset(scratch: Path) -> None:
    """The weather is the same."""
    env = make(SMALL, **IN_TURN, **FOUR)
    env.reset()
    env.step([20.0, 25.0])
    _, following = until(lambda: len(both := engines(env)) == 2 and both, "the next engine starts")
    watch = IdleWatch(following.pid)
    until(lambda: watch.look(0.005) > 0.3, "it waits")
    with no_room(env):
        _, info = env.reset()  # the engine is there; the next one cannot be
        assert info["engine_start"] == "prefetched"
        go(env, [[20.0, 25.0]] * 2)
    seen = [env.reset()[1] for _ in range(2)]
    assert [(info["weather"], info["engine_start"]) for info in seen] == [
        ("USA_CO_Denver", "started"),
        ("USA_FL_Miami", "prefetched"),
    ]
    env.close()


def two_files(folder: Path) -> dict[str, Any]:
    """Return the settings of two weather files with noise in turn, which each episode reads."""
    files = [folder / f"{name}.epw" for name in ("first", "second")]
    for file, name in zip(files, ("USA_CO_Denver", "USA_FL_Miami"), strict=True):
        shutil.copy(find_weather(name).path, file)
    noise = {"weather_noise": {"dry_bulb": {"sigma": 1.0, "tau_h": 24.0}}, "noise_start": "episode"}
    return {"weather": [*map(str, files)], "weather_order": "sequence", **noise}


HARMS: dict[str, Callable[[Path], object]] = {
    "cut off": lambda file: file.write_bytes(file.read_bytes()[:20_000]),
    "removed": Path.unlink,
}


@pytest.mark.slow
@pytest.mark.parametrize("harm", HARMS.values(), ids=HARMS)
def test_weather__file_that_is_damaged_while_a_node_runs_fails_its_episode(
    scratch: Path, harm: Callable[[Path], object]
) -> None:
    """The node names the file, goes on with the other one, and with this one once it is whole."""
    env = make(SMALL, **FOUR, **two_files(scratch), output_dir=str(scratch / "kept"))  # nothing is prefetched
    assert env.reset()[1]["weather"] == "first"
    shutil.copy(scratch / "second.epw", scratch / "whole")
    harm(scratch / "second.epw")
    for _ in range(2):
        with pytest.raises(SimulatorError, match=r"second\.epw"):
            env.reset()
        status = env.link.bus.status("building")
        assert (status.state, "second.epw" in status.failure) == (State.FAILED, True)
        assert env.reset()[1]["weather"] == "first"
        assert not env.link.bus.status("building").failure
    shutil.copy(scratch / "whole", scratch / "second.epw")
    assert env.reset()[1]["weather"] == "second"
    env.close()


@pytest.mark.slow
def test_snapshot_and_branch__without_room_leave_the_episode_running(scratch: Path) -> None:
    env = make(STOCHASTIC, **FOUR)
    mine = plan(env, 1)
    straight = episode(env, mine, seed=4)
    env.reset(seed=4)
    go(env, mine[:10])
    with env.snapshot() as kept:
        with no_room(env):
            for attempt in (env.snapshot, env.branch, lambda: env.reset(options={"snapshot": kept})):
                with pytest.raises(ForkFailed, match="cannot prepare"):
                    attempt()
        same(go(env, mine[10:20]), straight[11:21])
        env.reset(options={"snapshot": kept})
        same(go(env, mine[10:]), straight[11:])
    env.close()


@pytest.mark.slow
def test_baseline__that_cannot_be_forked_leaves_no_process(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    faults = Faults(scratch, monkeypatch)
    env = make(SMALL, **IN_TURN, **FOUR, baseline=True)
    for _ in range(2):
        env.reset()
        env.step([20.0, 25.0])
        until(lambda: len(engines(env)) == 3, "the next engine is there")
        faults.set(Faults.NO_MEMORY)
        with pytest.raises(ForkFailed):
            env.reset()
        faults.clear()
        until(lambda: all(map(runs, _children(env))), "all that have ended are reaped")
    env.reset()
    env.step([20.0, 25.0])
    env.close()


def _children(env: Any) -> list[psutil.Process]:
    return psutil.Process(env.local_node.pid).children(recursive=True)


@pytest.mark.slow
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one core")
@pytest.mark.parametrize("affinity", ["node", "apart"])
def test_prefetch__starts_on_other_cores_than_the_running_engine(scratch: Path, affinity: str) -> None:
    env = make(SMALL, **IN_TURN, **(FOUR | {"affinity": affinity}))
    env.reset()
    env.step([20.0, 25.0])
    present, ahead = until(lambda: len(running := engines(env)) == 2 and running, "the next engine is there")
    own = present.cpu_affinity()
    assert len(own) == 1
    until(lambda: ahead.cpu_affinity() == sorted(os.sched_getaffinity(0) - {*own}), "it is on the others")
    env.reset()
    assert ahead.cpu_affinity() == own
    env.close()


@pytest.fixture(scope="module")
def small_plan() -> Plan:
    return read_plan(read_config(OFFICE))


@pytest.fixture(scope="module")
def noisy_plan() -> Plan:
    return read_plan(read_config({"scenario": STOCHASTIC, "begin": "07-03", "end": "07-03"}))


def ended(client: EngineClient) -> None:
    client.interrupt()
    until(lambda: not client.alive, "the engine has ended")


@pytest.mark.slow
def test_template__that_dies_within_a_reset_leaves_the_files_of_its_successor(folder: Path, small_plan: Plan) -> None:
    """It was alive when the reset chose to fork it, and dead when it was forked."""
    template = EngineTemplate()
    pool = EnginePool(small_plan, folder, [template])
    first = pool.engine(0)
    assert template.engine is not None
    assert pool.next_episode(None, 1, untouched=()) is EngineStart.FORKED
    ended(template.engine)
    second = pool.engine(1)
    assert second.frame.number == 0
    assert (pool.files.model.parent / "eplusout.err").exists()
    for client in (first, second):
        client.close()
    pool.close()


@pytest.mark.slow
def test_reused_engine__that_dies_within_a_reset_leaves_the_files_of_its_successor(
    folder: Path, noisy_plan: Plan
) -> None:
    pool = EnginePool(noisy_plan, folder, [EngineTemplate()])
    first = pool.engine(0)
    assert pool.next_episode(None, 1, untouched=[first]) is EngineStart.REUSED
    ended(first)
    second = pool.engine(1)
    first.close()
    assert second.frame.number == 0
    assert (pool.files.model.parent / "eplusout.err").exists()
    second.close()
    pool.close()


@pytest.mark.slow
def test_prefetched_engine__that_dies_within_a_reset_is_replaced(folder: Path, noisy_plan: Plan) -> None:
    pool = EnginePool(noisy_plan, folder, [EngineTemplate()])
    first = pool.engine(0)
    assert pool.next_episode(None, 0, untouched=[first]) is EngineStart.REUSED
    pool.prefetch(0)
    assert pool.next_episode(None, 1, untouched=()) is EngineStart.PREFETCHED
    noise = pool.files.noise_parameters
    ahead = pool._prefetched
    ended(ahead.engine)
    second = pool.engine(1)
    assert second.frame.number == 0
    assert pool.files.noise_parameters == noise
    assert pool.warnings
    for client in (first, second):
        client.close()
    pool.close()


@pytest.mark.slow
@pytest.mark.parametrize("harm", HARMS.values(), ids=HARMS)
def test_prefetch__with_a_damaged_weather_file_leaves_the_episode_running(
    folder: Path, harm: Callable[[Path], object]
) -> None:
    settings = {"building": "ref-small-office", "begin": "07-03", "end": "07-03", **two_files(folder)}
    pool = EnginePool(read_plan(read_config(settings)), folder / "node", [EngineTemplate(), EngineTemplate()])
    first = pool.engine(0)
    harm(folder / "second.epw")
    pool.prefetch(0)
    first.confirm()
    pool.next_episode(None, 1, untouched=())
    with pytest.raises(SimulatorError, match=r"second\.epw"):
        pool.next_episode(None, 2, untouched=())
    first.close()
    pool.close()


def test_weather_sampler__looking_ahead_changes_no_draw() -> None:
    def drawn(looks: int) -> list[WeatherDraw]:
        sampler = WeatherSampler(3, "random", noisy=True)
        draws = [sampler.draw(5)]
        for _ in range(6):
            ahead = [sampler.look_ahead() for _ in range(looks)]
            draws.append(sampler.draw(None))
            assert ahead == draws[-1:] * looks
        return draws

    assert drawn(0) == drawn(1) == drawn(3)


def test_weather_sampler__two_seeds_in_a_row_make_the_next_draw_unpredictable() -> None:
    sampler, other = (WeatherSampler(3, "random", noisy=True) for _ in range(2))
    assert [sampler.draw(4), sampler.look_ahead() is None] == [other.draw(4), False]
    assert sampler.draw(4) == other.draw(4)
    assert sampler.look_ahead() is None
    assert sampler.draw(None) == other.draw(None)
    assert sampler.look_ahead() == other.draw(None)
