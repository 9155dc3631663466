"""Pictures of episodes: what they show is what happened, and equal histories give equal pictures."""

import subprocess
import sys
from collections.abc import Mapping
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Any

import gymnasium as gym
import matplotlib as mpl
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import zenostat  # noqa: F401  # registers the environments
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.episode_history import EpisodeHistory
from zenostat.agent_sdk.testing import FakeBuilding, FakeLink, Zone
from zenostat.agent_sdk.testing.fake_vector_env import FakeVectorEnv
from zenostat.topics.errors import EpisodeChanged
from zenostat.views.display.colors import zone_color
from zenostat.views.rendering.panels import Panel

Picture = NDArray[np.uint8]
BAND = (23.0, 26.0)
"""The linear reward's band in summer, degC."""


def fake(**arguments: Any) -> BuildingEnv:
    env = gym.make("zenostat/Fake-v1", **({"zones": 2, "render_mode": "rgb_array"} | arguments)).unwrapped
    assert isinstance(env, BuildingEnv)
    return env


def run(env: BuildingEnv, steps: int, seed: int = 1) -> list[tuple[NDArray[np.float64], Any, float, dict[str, Any]]]:
    """Run some timesteps with random actions; return values, action, reward and info of each."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    rows = []
    for _ in range(steps):
        action = env.action_space.sample()
        _, reward, _, _, info = env.step(action)
        rows.append((env.sample.values.copy(), action, float(reward), info))
    return rows


def panels(env: BuildingEnv) -> dict[str, Panel]:
    """Render, and return the panels by their titles with units."""
    env.render()
    assert env._renderer is not None
    return {panel._heading[0]: panel for panel in env._renderer._frame.panels}


def steps_of(line: Any) -> list[float]:
    """Return the value of each timestep of a line that is drawn as steps."""
    x, y = line.get_data()
    assert np.array_equal(y[::2], y[1::2], equal_nan=True)
    assert np.array_equal(x[1:-1:2], x[2::2])
    return list(y[::2])


def legend(panel: Panel) -> dict[str, str]:
    return {row.label: row.value for row in panel.rows}


def has_color(picture: Picture, color: tuple[float, ...]) -> bool:
    return bool((np.abs(picture - 255.0 * np.array(color)).max(axis=-1) <= 2.0).any())


# The interface


@pytest.mark.slow
def test_rendering__picture_has_gymnasiums_form_from_the_reset_to_the_end() -> None:
    env = fake(steps_per_hour=1)
    with pytest.raises(EpisodeChanged, match="reset"):
        env.render()
    env.reset(seed=0)
    pictures = [env.render()]
    for _ in range(24):
        *_, truncated, _ = env.step(env.action_space.sample())
        pictures.append(env.render())
    assert truncated
    assert {(picture.shape, picture.dtype.name) for picture in pictures} == {((640, 960, 3), "uint8")}
    assert all((one != other).any() for one, other in pairwise(pictures))
    env.reset(seed=0)
    assert np.array_equal(env.render(), pictures[0])


@pytest.mark.filterwarnings("ignore:.*Box observation space (minimum|maximum) value is (-)?infinity.*")
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space.*")
def test_rendering__gymnasiums_checker_passes_with_its_render_modes() -> None:
    check_env(fake())


def test_rendering__gymnasium_collects_the_frames_of_an_episode() -> None:
    env = gym.make("zenostat/Fake-v1", zones=1, render_mode="rgb_array_list")
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    frames: Any = env.render()
    assert [frame.shape for frame in frames] == [(640, 960, 3)] * 4


def test_rendering__without_a_render_mode_nothing_is_recorded_or_imported() -> None:
    script = (
        "import sys, gymnasium, zenostat\n"
        "env = gymnasium.make('zenostat/Fake-v1'); env.reset(seed=0); env.step(env.action_space.sample())\n"
        "assert env.unwrapped._history is None and 'matplotlib' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


# Equal pictures


@pytest.mark.slow
def test_rendering__picture_depends_on_its_samples_alone() -> None:
    """Neither on what was drawn before, nor on the user's style."""
    once, often = fake(end="07-04"), fake(end="07-04")
    run(once, 110)
    often.reset(seed=3)
    often.render()
    often.reset(seed=1)
    often.action_space.seed(1)
    for step in range(110):
        often.step(often.action_space.sample())
        if step % 10 == 0:
            often.render()
    expected = once.render()
    assert np.array_equal(often.render(), expected)
    with mpl.rc_context({"font.family": "serif", "lines.linewidth": 9.0, "axes.facecolor": "black"}):
        styled = fake(end="07-04")
        run(styled, 110)
        assert np.array_equal(styled.render(), expected)


def test_rendering__slots_picture_is_that_of_a_single_environment() -> None:
    vector, single = FakeVectorEnv(2, zones=2, render_mode="rgb_array"), fake()
    with pytest.raises(EpisodeChanged, match="reset"):
        vector.render()
    vector.reset(seed=5)
    single.reset(seed=6)
    for _ in range(20):
        actions = np.stack([single.action_space.sample(), single.action_space.sample()])
        vector.step(actions)
        single.step(actions[1])
    first, second = vector.render()
    assert np.array_equal(second, single.render())
    assert np.array_equal(vector.envs[1].render(), second)
    assert (first != second).any()


def test_rendering__slot_that_starts_anew_shows_only_its_new_episode() -> None:
    vector = FakeVectorEnv(2, zones=1, steps_per_hour=1, render_mode="rgb_array")
    vector.reset(seed=0)
    actions = np.array([[20.0, 25.0]] * 2)
    for _ in range(25):
        vector.step(actions)
    again, only_first = FakeVectorEnv(2, zones=1, steps_per_hour=1, render_mode="rgb_array"), vector.render()
    again.reset(seed=0)
    for _ in range(24):
        again.step(actions)
    assert (again.render()[0] != only_first[0]).any()
    assert vector._renderer is not None
    assert [len(history.rows) for history in vector._renderer.histories] == [1, 1]


# What it shows


def test_rendering__lines_are_the_samples() -> None:
    env = fake(control="zone")
    rows = run(env, 30)
    shown = panels(env)
    index = {name: i for i, name in enumerate(env.manifest.names)}
    zones = shown["Zone temperature (°C)"]
    for line, zone in zip(zones._lines, ("zone_1", "zone_2"), strict=True):
        assert list(line.get_ydata())[1:] == [row[0][index[f"{zone}_air_temperature"]] for row in rows]
        assert np.allclose(line.get_xdata(), np.arange(31) / 4.0)
    outdoor = shown["Outdoor temperature (°C)"]._lines[0].get_ydata()
    assert list(outdoor)[1:] == [row[0][index["outdoor_temperature"]] for row in rows]
    hvac_kw = steps_of(shown["Electric power (kW)"]._lines[1])
    assert hvac_kw == pytest.approx([row[0][index["hvac_electricity"]] / 900.0 / 1e3 for row in rows])
    people = steps_of(shown["Occupancy (people)"]._lines[0])
    assert people == [row[0][[index["zone_1_occupants"], index["zone_2_occupants"]]].sum() for row in rows]
    assert sum(people) == 0.0  # before 8 o'clock
    for number, line in enumerate(shown["Action (°C)"]._lines):
        assert steps_of(line) == [float(row[1][number]) for row in rows]
    reward, energy, comfort = shown["Reward"]._lines
    assert steps_of(reward) == [row[2] for row in rows]
    assert steps_of(energy) == [row[3]["reward_terms"]["energy"] for row in rows]
    assert steps_of(comfort) == [row[3]["reward_terms"]["comfort"] for row in rows]
    assert float(shown["Reward"]._heading[1].removeprefix("sum ").replace("\N{MINUS SIGN}", "-")) == pytest.approx(
        sum(row[2] for row in rows), rel=0.01
    )


def test_rendering__legend_has_the_latest_values() -> None:
    env = fake()
    values, action, *_ = run(env, 40)[-1]
    shown, index = panels(env), {name: i for i, name in enumerate(env.manifest.names)}
    zones, actions = legend(shown["Zone temperature (°C)"]), legend(shown["Action (°C)"])
    assert zones["Zone 1"] == f"{values[index['zone_1_air_temperature']]:.1f}"
    assert zones["Comfort band"] == "23.0 to 26.0"
    assert actions["Zone 1 heating setpoint"] == f"{action[0]:.1f}"


def test_rendering__setpoints_are_those_in_effect() -> None:
    env = fake(control="building")
    env.reset(seed=0)
    for heating in (17.0, 21.0, 19.0):
        env.step([heating, 25.5])
    panel: Any = panels(env)["Zone temperature (°C)"]
    heating_lines, cooling_lines = panel._setpoint_lines
    assert steps_of(heating_lines[0]) == [17.0, 21.0, 19.0]
    assert steps_of(cooling_lines[0]) == [25.5] * 3
    assert legend(panel)["Setpoints"] == "19.0 to 25.5"
    assert not len(heating_lines[1].get_xdata())  # both zones have the same


def test_rendering__band_and_occupied_hours_are_where_they_belong() -> None:
    """The band's pixels are those of its temperatures, and the people's stripe begins at 8 o'clock."""
    env = fake(control="building")
    env.reset(seed=1)
    for _ in range(48):
        env.step([15.0, 30.0])
    picture = env.render()
    panel: Any = panels(env)["Zone temperature (°C)"]
    edges = panel._band.get_xy()[:, 1]
    assert (edges.min(), edges.max()) == BAND
    (stripe,) = panel._occupied.get_paths()
    assert sorted({x for x, _ in stripe.vertices.tolist()}) == [8.0, 12.0]

    def color_at(degc: float, hour: float) -> tuple[int, ...]:
        x, y = panel.axes.transData.transform((hour, degc))
        return tuple(picture[639 - int(y), int(x)].tolist())

    white, green = (255, 255, 255), tuple(round(255 * (1 - 0.17 * (1 - part))) for part in (0.30, 0.66, 0.42))
    assert color_at(28.6, 1.3) == white
    assert color_at(25.4, 1.3) == pytest.approx(green, abs=2)
    assert color_at(28.6, 10.3) not in {white, green}
    assert color_at(25.4, 10.3) not in {white, green, color_at(28.6, 10.3)}


@pytest.mark.slow
def test_rendering__zones_have_the_colors_of_all_pictures() -> None:
    from zenostat.metrics.roles import roles

    env = fake(zones=4)
    run(env, 20)
    picture = env.render()
    colors = [tuple(part / 255.0 for part in zone_color(zone.place)) for zone in roles(env.manifest).zones]
    assert all(has_color(picture[:, 46:700], color) for color in colors)
    assert all(has_color(picture[:, 714:732], color) for color in colors)  # in the legend


def test_rendering__no_text_is_cut_and_nothing_covers_the_curves() -> None:
    """Margins are blank, and between plot and legend there is a gap."""
    for zones in (1, 3, 20):
        env = fake(zones=zones)
        run(env, 60)
        picture = env.render()
        assert (picture[:, 954:] == 255).all()
        assert (picture[30:610, 706:712] == 255).all()
        assert (picture[:6] == 255).all()
        assert (picture[636:] == 255).all()
        assert (picture[30:600, 714:950] < 120).any(axis=(1, 2)).mean() > 0.15  # legends


def test_rendering__many_zones_are_a_range_and_the_worst_zone() -> None:
    zones = [Zone(f"zone_{n}") for n in range(9)] + [Zone("attic", aperture_m2=9.0, cooling_w=0.0)]
    env = fake(zones=zones, reward={"kind": "linear", "summer": (15.0, 26.0)})
    rows = run(env, 72)
    panel: Any = panels(env)["Zone temperature (°C)"]
    air = [i for i, name in enumerate(env.manifest.names) if name.endswith("_air_temperature")]
    table = np.array([row[0][air] for row in rows])
    outside = np.maximum(np.maximum(15.0 - table, table - 26.0), 0.0).sum(axis=0)
    assert outside.argmax() == 9  # the attic
    assert "Worst: Attic" in legend(panel)
    assert list(panel._lines[0].get_ydata())[1:] == table[:, 9].tolist()
    assert list(panel._medians[0].get_ydata())[1:] == pytest.approx(np.median(table, axis=1).tolist())
    assert legend(panel)["10 zones, with median"] == f"{table[-1].min():.1f} to {table[-1].max():.1f}"
    actions = panels(env)["Action (°C)"]
    assert set(legend(actions)) == {"10 heating setpoints", "10 cooling setpoints"}


# Other tasks


def test_rendering__choice_is_shown_with_what_it_sets() -> None:
    env = fake(control="building", discrete=5)
    env.reset(seed=0)
    for choice in (0, 4, 2):
        env.step(choice)
    panel = panels(env)["Action: choice, 0 to 4"]
    assert steps_of(panel._lines[0]) == [0.0, 4.0, 2.0]
    heating, cooling = env.manifest.task.discrete_actions[0].values[2]
    assert legend(panel) == {
        "Choice": "2", "Heating setpoint": f"{heating:.1f} °C", "Cooling setpoint": f"{cooling:.1f} °C",
    }  # fmt: skip


def test_rendering__several_choices_have_a_lane_each() -> None:
    env = fake(control="zone", discrete=3)
    env.reset(seed=0)
    env.step([0, 2])
    env.step([1, 0])
    panel = panels(env)["Action: choices"]
    assert legend(panel) == {"Zone 1": "1", "Zone 2": "0"}
    first, second = (np.array(steps_of(line)) for line in panel._lines)
    assert first == pytest.approx([-0.9, -0.5])
    assert second == pytest.approx([-1.1, -1.9])


def test_rendering__without_reward_and_actions_their_panels_are_left_out() -> None:
    env = fake(reward=None, actions={})
    run(env, 3)
    titles = set(panels(env))
    assert "Reward" not in titles
    assert not any(title.startswith("Action") for title in titles)
    scenario = BuildingEnv(link=FakeLink(FakeBuilding(2, reward=None)), render_mode="rgb_array")
    run(scenario, 3)
    assert legend(panels(scenario)["Zone temperature (°C)"])["Comfort band (default)"] == "20.0 to 26.0"


def test_rendering__reward_of_many_terms_shows_the_first_and_the_rest() -> None:
    def many(values: Mapping[str, Any], begin: datetime) -> dict[str, float]:
        return {f"term_{n}": -float(n) for n in range(7)}

    env = fake(reward=many)
    run(env, 3)
    panel = panels(env)["Reward"]
    assert steps_of(panel._lines[-1]) == [-(3.0 + 4.0 + 5.0 + 6.0)] * 3
    assert list(legend(panel))[-1] == "4 other terms"


def test_rendering__terms_that_change_during_an_episode_are_those_of_the_latest_timestep() -> None:
    def changing(values: Mapping[str, Any], begin: datetime) -> dict[str, float]:
        return {"energy": -1.0, "cold" if begin.hour < 2 else "hot": -2.0}

    env = fake(reward=changing, steps_per_hour=1)
    run(env, 2)
    assert "Cold term" in legend(panels(env)["Reward"])
    for _ in range(2):
        env.step(env.action_space.sample())
    panel = panels(env)["Reward"]
    assert list(legend(panel)) == ["Reward", "Energy term", "Hot term"]
    np.testing.assert_array_equal(steps_of(panel._lines[2]), [np.nan, np.nan, -2.0, -2.0])


def test_rendering__values_that_are_not_finite_leave_a_gap() -> None:
    env = fake(zones=7, steps_per_hour=1)
    run(env, 2)
    assert env._history is not None
    unknown, effective = np.full(len(env.manifest.points), np.nan), np.full(len(env.manifest.actuators), np.inf)
    time = env.sample.time + timedelta(hours=1)
    env._history.add(time, unknown, effective, np.full(14, np.nan), float("inf"), {"energy": np.nan, "comfort": np.inf})
    shown = panels(env)
    assert np.isnan(steps_of(shown["Reward"]._lines[0])[-1])
    assert np.isnan(shown["Zone temperature (°C)"]._medians[0].get_ydata()[-1])
    assert legend(shown["Electric power (kW)"])["HVAC"] == "n/a"
    assert env.render().shape == (640, 960, 3)


# Recording


@pytest.mark.parametrize(
    ("step_s", "rows"), [(1.0, 1441), (60.0, 1441), (900.0, 97), (3600.0, 49), (86400.0, 49)], ids=str
)
def test_rendering__day_is_recorded_but_not_too_few_or_too_many_timesteps(step_s: float, rows: int) -> None:
    step, begin = timedelta(seconds=step_s), datetime(2017, 1, 1)  # local standard time
    history, values = EpisodeHistory(step), np.zeros(1)
    history.start(begin, values, values, {})
    for number in range(1, 2000):
        history.add(begin + number * step, values, values, [0.0], -1.0, {})
    assert len(history.rows) == rows
    assert history.rows[-1][0] - history.rows[0][0] == history.span
    assert history.total == -1999.0


def test_rendering__action_array_that_is_used_again_does_not_change_the_record() -> None:
    env = fake(zones=1)
    env.reset(seed=0)
    action = np.array([20.0, 25.0])
    env.step(action)
    action[:] = 22.0, 28.0
    env.step(action)
    assert steps_of(panels(env)["Action (°C)"]._lines[0]) == [20.0, 22.0]
