"""Noise from the third day: an episode is a fork that continues with another weather file.

It must be equal to the bit to an episode that starts with that file.
"""

import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from support.engine_forks import KINDS, SMALL, Row, engines, episode, go, make, plan, row, same
from support.nodes import until

from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.eplus_node.config import read_config
from zenostat.eplus_node.plan import plan as read_plan
from zenostat.models.catalog import find_weather
from zenostat.topics.errors import InvalidConfig

NOISE = {"dry_bulb_temperature": {"sigma": 3.0, "mu": 1.0}, "direct_normal_radiation": {"sigma": 80.0}}
LATE = {"weather_noise": NOISE, "noise_start": "third_day", "end": "07-06", "steps_per_hour": 1}
NOISE_FREE_H = 48


def weather_file(env: BuildingEnv) -> Path:
    """Return the file that the node has for the running episode."""
    assert env.local_node is not None
    (path,) = env.local_node.folder.rglob("episode-*.epw")
    return path


def fresh(env: BuildingEnv, folder: Path, name: str, actions: list[Any], **settings: Any) -> list[Row]:
    """Return the episode of an engine that starts with the weather file of the running episode."""
    weather = shutil.copy(weather_file(env), folder / "combined.epw")
    source = str(settings.get("weather", ""))
    original = Path(source) if source.endswith(".epw") else find_weather(env.manifest.weather).path
    original, days = original.with_suffix(".ddy"), folder / "combined.ddy"
    days.unlink(missing_ok=True)
    if original.is_file():
        shutil.copy(original, days)
    settings = {k: v for k, v in settings.items() if k not in ("weather_noise", "noise_start", "weather_order")}
    again = make(name, **settings | {"weather": str(weather)})
    rows = episode(again, actions)
    again.close()
    return rows


def dates(**settings: str) -> dict[str, Any]:
    return LATE | settings


CASES = {"small office": (SMALL, LATE)}
SLOW_CASES = {
    "five zones, a fifth of an hour": (KINDS["five zones"], LATE | {"steps_per_hour": 12, "end": "07-05"}),
    "over New Year": (SMALL, dates(begin="2017-12-28", end="2018-01-02")),
    "data centre, end of the year": (KINDS["data centre, DX"], dates(begin="12-28", end="12-31")),
    "chilled water, a minute": (KINDS["data centre, chilled water"], LATE | {"steps_per_hour": 60, "end": "07-05"}),
    "medium office with EMS": (KINDS["medium office with EMS"], LATE | {"steps_per_hour": 4, "end": "07-12"}),
    "battery, turn of February": (KINDS["photovoltaics and battery"], dates(begin="02-26", end="03-03")),
    "grid battery": (KINDS["battery that is controlled"], dates(begin="01-01", end="01-05")),
    "residence with radiant floors": ("radiant-mixed-discrete-v1", LATE | {"begin": "10-03", "end": "10-07"}),
    "a year": (SMALL, dates(begin="01-01", end="12-31")),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        *(pytest.param(*case, id=text) for text, case in CASES.items()),
        *(pytest.param(*case, id=text, marks=pytest.mark.slow) for text, case in SLOW_CASES.items()),
    ],
)
def test_episode__equals_one_that_starts_with_its_weather_file(
    scratch: Path, module_folder: Path, name: str, settings: dict[str, Any]
) -> None:
    env = make(name, **settings)
    mine = plan(env, 1)
    first = episode(env, mine, seed=4)
    _, info = env.reset(seed=5)
    assert info["engine_start"] == "forked"
    second = [row(env), *go(env, mine)]
    same(second, fresh(env, module_folder, name, mine, **settings))
    same(episode(env, mine, seed=4), first)  # the seed determines it
    begin = NOISE_FREE_H * settings["steps_per_hour"]
    differs = (np.array(first) != np.array(second)).any(axis=1)
    assert not differs[: begin + 1].any()  # no noise in the first two days
    assert differs[begin + 1 :].any()
    env.close()


@pytest.mark.slow
def test_episode__over_a_leap_day_equals_one_that_starts_with_its_weather_file(
    scratch: Path, module_folder: Path
) -> None:
    path = module_folder / "leap.epw"
    settings = dates(begin="2020-02-26", end="2020-03-03", weather=str(path))
    path.write_bytes(_with_leap_day(find_weather("USA_CO_Denver").path.read_bytes()))
    env = make(SMALL, **settings)
    mine = plan(env, 1)
    rows = episode(env, mine, seed=4)
    assert len(rows) == 7 * 24 + 1
    same(rows, fresh(env, module_folder, SMALL, mine, **settings))
    env.close()


def _with_leap_day(text: bytes) -> bytes:
    """Repeat 28 February as 29 February, and say so in the header."""
    lines = text.split(b"\r\n" if b"\r\n" in text else b"\n")
    lines[4] = lines[4].replace(b"SAVINGS,No", b"SAVINGS,Yes", 1)
    last = max(k for k, line in enumerate(lines) if line.split(b",")[1:3] == [b"2", b"28"])
    repeated = [
        b",".join([*line.split(b",")[:2], b"29", *line.split(b",")[3:]]) for line in lines[last - 23 : last + 1]
    ]
    return b"\r\n".join([*lines[: last + 1], *repeated, *lines[last + 1 :]])


def weather_of(env: BuildingEnv) -> NDArray[np.float64]:
    columns = ["dry_bulb_temperature", "direct_normal_radiation"]
    return np.frombuffer(env.weather(columns).values).reshape(-1, len(columns))


@pytest.mark.slow
def test_weather__of_the_episode_is_what_info_and_forecasts_have(scratch: Path) -> None:
    env, plain = make(SMALL, **LATE), make(SMALL, end="07-06", steps_per_hour=1)
    plain.reset()
    undisturbed, seen = weather_of(plain), []
    plain.close()
    for seed in (1, 2, 1):
        _, info = env.reset(seed=seed)
        assert (info["weather"], info["weather_noise"]["dry_bulb_temperature.sigma"]) == ("USA_CO_Denver", 3.0)
        seen.append(weather_of(env))
        assert np.array_equal(seen[-1][:NOISE_FREE_H], undisturbed[:NOISE_FREE_H])
        assert (seen[-1][NOISE_FREE_H:, 0] != undisturbed[NOISE_FREE_H:, 0]).all()
        rows = go(env, plan(env, 1))
        outdoor = 1 + env.manifest.names.index("outdoor_temperature")
        assert [row[outdoor] for row in rows] == pytest.approx(seen[-1][: len(rows), 0])  # EnergyPlus simulated it
    assert np.array_equal(seen[0], seen[2])
    assert not np.array_equal(seen[0], seen[1])
    env.close()


@pytest.mark.slow
def test_several_weather_files__have_an_engine_each(scratch: Path, module_folder: Path) -> None:
    settings = LATE | {"weather": ["USA_CO_Denver", "USA_FL_Miami"], "weather_order": "sequence"}
    env = make(SMALL, **settings)
    mine, seen = plan(env, 1), []
    for number in range(4):
        _, info = env.reset(seed=3 if number == 0 else None)
        seen.append((info["weather"], info["engine_start"]))
        rows = [row(env), *go(env, mine)]
        same(rows, fresh(env, module_folder, SMALL, mine, **settings))
    assert [weather for weather, _ in seen] == ["USA_CO_Denver", "USA_FL_Miami"] * 2
    assert [start for _, start in seen[2:]] == ["forked", "forked"]
    env.close()


@pytest.mark.slow
def test_snapshots_and_branches__continue_with_the_episodes_weather(scratch: Path) -> None:
    env = make(SMALL, **LATE)
    mine = plan(env, 1)
    straight = episode(env, mine, seed=4)
    env.reset(seed=4)
    go(env, mine[:10])
    kept, branch = env.snapshot(), env.branch()
    env.reset(seed=9)
    go(env, mine[:3])
    same(go(branch, mine[10:]), straight[11:])
    branch.close()
    env.reset(options={"snapshot": kept})
    same(go(env, mine[10:]), straight[11:])
    same(episode(env, mine, seed=4), straight)
    kept.close()
    env.close()


@pytest.mark.slow
def test_slots__have_noise_of_their_own_from_one_engine(scratch: Path) -> None:
    envs = gym.make_vec(
        SMALL, num_envs=2, vectorization_mode="vector_entry_point", affinity="off", begin="07-03", **LATE
    )
    single = make(SMALL, **LATE)
    mine = plan(single, 1)
    for _ in range(2):
        envs.reset(seed=[7, 8])
        expected = [episode(single, mine, seed=seed) for seed in (7, 8)]
        for number, action in enumerate(mine[:60], 1):
            envs.step([action, action])
            values = envs.unwrapped._sample.values  # type: ignore[attr-defined]
            for slot in range(2):
                assert values[slot].tolist() == expected[slot][number][1 : 1 + values.shape[1]]
    envs.close()
    single.close()


@pytest.mark.slow
def test_waiting_engine__that_dies_is_replaced(scratch: Path) -> None:
    env = make(SMALL, **LATE)
    mine = plan(env, 1)
    straight = episode(env, mine, seed=4)
    for engine in engines(env):
        engine.kill()
    until(lambda: not engines(env), "the engines have ended")
    same(episode(env, mine, seed=4), straight)
    env.close()


@pytest.mark.slow
def test_kept_output__has_the_same_episode(scratch: Path) -> None:
    """With a folder for output each episode has an engine of its own, which starts with the file."""
    env, kept = make(SMALL, **LATE), make(SMALL, **LATE, output_dir=scratch / "kept")
    mine = plan(env, 1)
    same(episode(kept, mine, seed=4), episode(env, mine, seed=4))
    env.close()
    kept.close()


# What is refused


def refusal(**settings: Any) -> str:
    with pytest.raises(InvalidConfig) as refused:
        read_plan(read_config({"scenario": SMALL, "begin": "07-03", "end": "07-06", "weather_noise": NOISE} | settings))
    return str(refused.value)


def test_noise_start__run_period_that_ends_before_the_noise_is_refused() -> None:
    text = refusal(noise_start="third_day", end="07-04")
    assert text == (
        "noise_start: third_day needs a run period of at least 3 days; this one has 2 days, and they would have no "
        "noise"
    )
    read_plan(
        read_config({"scenario": SMALL, "begin": "07-03", "end": "07-04", "noise_start": "third_day"})
    )  # no noise


def test_noise_start__period_whose_third_day_is_in_the_next_year_is_refused() -> None:
    text = refusal(noise_start="third_day", begin="2017-12-30", end="2018-01-03")
    assert "begins on 12-30: the weather file " in text
    assert "ends before the third day; begin on another day, or use noise_start: episode" in text


def test_noise_start__unknown_start_is_refused() -> None:
    assert "'episode' or 'third_day'" in refusal(noise_start="fourth_day")


def test_noise_start__model_that_reads_the_whole_weather_before_is_refused() -> None:
    mains = {"Site:WaterMainsTemperature": {"*": {"calculation_method": "CorrelationFromWeatherFile"}}}
    text = refusal(noise_start="third_day", edits=mains)
    assert "Site:WaterMainsTemperature reads the whole weather file before the episode starts" in text
