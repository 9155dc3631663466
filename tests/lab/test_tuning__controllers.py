"""Tuning of controllers: within one process, and as studies."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zenostat.agent_sdk.controllers import Agent, Controller, RuleBasedController, load_controller
from zenostat.agent_sdk.testing.fake_env import FakeEnv
from zenostat.lab.evaluate import evaluate, run_episode
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, UnknownName

optuna = pytest.importorskip("optuna")

from support.tuning import kill_first_process, load_tuning  # noqa: E402

from zenostat.lab.tuning import RULE_SEARCH_SPACE, tune_controller  # noqa: E402
from zenostat.lab.tuning.controller_episodes import ControllerEpisodes  # noqa: E402
from zenostat.lab.tuning.study import Tuning  # noqa: E402
from zenostat.lab.tuning.study_figures import write_results  # noqa: E402
from zenostat.lab.tuning.trial import mean_metric  # noqa: E402
from zenostat.lab.tuning.tuning_file import read_tuning  # noqa: E402

FAKE: dict[str, Any] = {"zones": 1, "end": "07-03", "steps_per_hour": 2, "control": "building"}
ARGUMENTS = {"scenario": "Fake-v1", **FAKE}
SPACE: dict[str, Any] = {"margin": {"low": 0.0, "high": 1.5}, "setback": {"low": 0.0, "high": 6.0}}


def study(output: Path, **changes: Any) -> Any:
    fields = {
        "study": "s", "controller": "rbc", "scenario": "Fake-v1", "arguments": FAKE, "parameters": SPACE, "trials": 4,
        "seeds": [0, 1], "output": str(output),
    }  # fmt: skip
    return read_tuning({**fields, **changes})


# Within one process


def test_mean_metric__that_is_no_number_is_an_error_with_the_episode() -> None:
    episodes = [SimpleNamespace(metrics=lambda value=value: {"reward": value}) for value in (1.0, math.nan, 3.0)]
    assert mean_metric([episodes[0], episodes[2]], "reward") == 2.0
    with pytest.raises(InvalidConfig, match="metric: reward is NaN in episode 2"):
        mean_metric(episodes, "reward")


def test_tune_controller__value_is_the_mean_over_the_episodes_of_a_new_controller() -> None:
    tuned = tune_controller("rbc", ARGUMENTS, SPACE, seeds=(3, 4), trials=4, fixed={"preconditioning": 2.0})
    env = FakeEnv(**FAKE)
    for trial in tuned.trials:
        rewards = []
        for seed in (3, 4):
            agent = Agent(RuleBasedController(env.manifest, preconditioning=2.0, **trial.parameters))
            rewards.append(run_episode(env, lambda _, agent=agent: agent.action(env.sample), seed=seed)[0].reward)
        assert trial.value == np.mean(rewards)
    assert tuned.trials[0].parameters == {}
    assert tuned.default_value == tuned.trials[0].value
    assert tuned.value == max(trial.value for trial in tuned.trials)
    assert tuned.parameters["preconditioning"] == 2.0
    assert tuned.plain() == {"controller": "rbc", "parameters": tuned.parameters}


def test_controller_episodes__a_reward_that_keeps_maxima_forgets_them_with_each_controller() -> None:
    episodes = ControllerEpisodes({**ARGUMENTS, "reward": {"kind": "normalized"}})
    factory = load_controller("rbc")
    first = episodes.value(factory, {}, "reward")
    other = episodes.value(factory, {"margin": 1.5, "setback": 6.0}, "reward")
    assert other != first
    assert episodes.value(factory, {}, "reward") == first
    episodes.close()


@pytest.mark.variants
@pytest.mark.parametrize("sampler", ["tpe", "random", "cma-es"])
def test_tune_controller__repeats_to_the_bit_and_depends_on_the_seed(sampler: Any) -> None:
    def run(seed: int) -> Any:
        return tune_controller("rbc", ARGUMENTS, SPACE, trials=8, sampler=sampler, seed=seed, prune=False)

    first = run(1)
    assert run(1) == first
    assert run(2).trials != first.trials
    drawn = [tuple(trial.parameters.values()) for trial in first.trials[1:]]
    assert len(set(drawn)) == 7


def test_tune_controller__cma_es_draws_generations_around_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cmaes")
    monkeypatch.setattr(ControllerEpisodes, "value", quadratic)
    space = {name: {"low": -5.0, "high": 5.0, "start": 4.0} for name in ("heating_margin", "cooling_margin")}
    tuned = tune_controller("rbc", ARGUMENTS, space, trials=120, sampler="cma-es", seed=0)
    points = np.array([list(trial.parameters.values()) for trial in tuned.trials[1:]])
    assert points[0].tolist() == [4.0, 4.0]
    assert np.abs(points[1:7] - 4.0).max() < 5.0  # a sixth of the range is the first standard deviation
    assert np.abs(points[-6:] - 1.0).max() < 0.5  # and the last generation is at the optimum
    assert tuned.parameters == pytest.approx({"heating_margin": 1.0, "cooling_margin": 1.0}, abs=0.2)


def quadratic(episodes: Any, factory: Any, parameters: Any, metric: str, report: Any) -> float:
    """An objective with its maximum, 0, where all parameters are 1; the defaults have -100."""
    return -sum((value - 1.0) ** 2 for value in parameters.values()) if parameters else -100.0


def test_tune_controller__search_begins_with_the_default_and_the_start() -> None:
    space = {name: {**searched, "start": 0.5} for name, searched in SPACE.items()}
    trials = tune_controller("rbc", ARGUMENTS, space, trials=3).trials
    assert [trial.parameters for trial in trials[:2]] == [{}, {"margin": 0.5, "setback": 0.5}]


def test_tune_controller__default_wins_where_nothing_is_better() -> None:
    tuned = tune_controller("rbc", ARGUMENTS, {"margin": [30.0], "low": [-30.0]}, trials=2)
    assert tuned.parameters == {}
    assert tuned.value == tuned.default_value


@pytest.mark.slow
def test_tune_controller__trials_below_the_median_are_ended_and_the_best_is_the_same() -> None:
    reports: list[Any] = []
    whole = tune_controller("rbc", ARGUMENTS, SPACE, seeds=(0, 1, 2), trials=14, sampler="random", prune=False)
    pruned = tune_controller(
        "rbc", ARGUMENTS, SPACE, seeds=(0, 1, 2), trials=14, sampler="random",
        progress=lambda *state: reports.append(state),
    )  # fmt: skip
    assert any(trial.pruned for trial in pruned.trials)
    assert not any(trial.pruned for trial in pruned.trials[:5])
    assert [trial.parameters for trial in pruned.trials] == [trial.parameters for trial in whole.trials]
    assert (pruned.parameters, pruned.value) == (whole.parameters, whole.value)
    assert [(number, total) for number, total, *_ in reports] == [(k, 14) for k in range(1, 15)]
    assert reports[-1][3] == pruned.value


def test_tune_controller__trial_that_has_had_its_last_episode_is_finished() -> None:
    tuned = tune_controller("rbc", ARGUMENTS, SPACE, trials=12, sampler="random")
    assert not any(trial.pruned for trial in tuned.trials)


@pytest.mark.parametrize(
    ("metric", "direction"),
    [
        ("reward", "maximize"), ("reward.comfort", "maximize"), ("mean_reward", "maximize"),
        ("hvac_electricity_kwh", "minimize"), ("kpi.tdis_tot", "minimize"),
    ],
)  # fmt: skip
def test_tuning_file__direction_is_that_of_the_metric_unless_it_is_named(metric: str, direction: str) -> None:
    assert study(Path(), metric=metric).direction == direction
    assert study(Path(), metric=metric, direction="maximize").direction == "maximize"


def test_tune_controller__another_metric_is_minimized() -> None:
    tuned = tune_controller("rbc", ARGUMENTS, SPACE, trials=4, metric="outside_kh", sampler="random")
    assert tuned.value == min(trial.value for trial in tuned.trials)


class Own(Controller):
    """A controller of the user's."""

    def __init__(self, manifest: Any, *, setpoint: float, other: float = 1.0) -> None:
        super().__init__(manifest)
        self._setpoint = setpoint

    def act(self, sample: Any) -> Any:
        values = {}
        for actuator in self.manifest.actuators:
            values[actuator.name] = self._setpoint + (2.0 if actuator.control_type.startswith("Cool") else -2.0)
        return values


def test_tune_controller__class_with_a_required_parameter_needs_it_fixed() -> None:
    tuned = tune_controller(Own, ARGUMENTS, {"other": [2.0]}, trials=2, fixed={"setpoint": 22.5})
    assert (tuned.controller, tuned.parameters) == ("Own", {"setpoint": 22.5})
    with pytest.raises(InvalidConfig, match="setpoint has no default, with which a study begins: set it in fixed="):
        tune_controller(Own, ARGUMENTS, {"setpoint": {"low": 20.0, "high": 24.0}})


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"parameters": {"marign": [1.0]}}, "RuleBasedController has no parameter 'marign'; did you mean 'margin'"),
        ({"parameters": {"margin": {"low": 1.0}}}, "margin: either low and high, or choices expected"),
        ({"parameters": {"margin": {"low": 0.0, "high": 1.0, "start": 2.0}}}, "start has to lie between low and high"),
        (
            {"parameters": {"margin": {"low": 0.6, "high": 1.6, "step": 0.25, "start": 1.0}}},
            "start = 1 is no multiple of 0.25 from low = 0.6 on",
        ),
        ({"parameters": {"margin": {"low": 1, "high": 10, "step": 20}}}, "step = 20 is longer than the range from 1"),
        ({"parameters": {"margin": {"low": 0, "high": 1, "start": 0.5}}}, "start = 0.5 is no whole number, but low"),
        ({"fixed": {"margin": 1.0}}, "margin is both searched and fixed; remove one of both"),
        ({"trials": 0}, "trials=0"),
        ({"metric": "rewrad"}, "metric: the evaluations have no 'rewrad'; did you mean 'reward'"),
        ({"metric": "kpi.emis_tot"}, "metric: kpi.emis_tot needs prices or emission factors"),
        ({"arguments": {"scenario": "Fke-v1"}}, "there is no scenario 'Fke-v1'; did you mean 'Fake-v1'"),
    ],
)
def test_tune_controller__bad_input_is_one_sentence(changes: dict[str, Any], text: str) -> None:
    fields = {"controller": "rbc", "arguments": ARGUMENTS, "parameters": SPACE, "trials": 2, **changes}
    with pytest.raises((InvalidConfig, UnknownName), match=text):
        tune_controller(**fields)


# Studies


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"trials": None}, "trials: it is missing"),
        ({"training": "t.yaml"}, "either a training or a controller; remove one of the fields"),
        ({"sceanrio": "x"}, "did you mean 'scenario'"),
        ({"seeds": []}, "seeds: "),
        ({"parameters": {"margin": {"low": 0.0, "high": 1.0}}, "sampler": "cma-es"}, "cma-es needs two or more ranges"),
        ({"parameters": {**SPACE, "low": [18.0]}, "sampler": "cma-es"}, "low is a list of choices; use tpe"),
    ],
)
def test_controller_study__bad_file_is_one_sentence(changes: dict[str, Any], text: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=text):
        study(tmp_path, **changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"controller": "rcb"}, "no controller 'rcb'; did you mean 'rbc'"),
        ({"parameters": {"marign": [1]}}, "no parameter 'marign'"),
        ({"scenario": "Fke-v1"}, "there is no scenario 'Fke-v1'"),
    ],
)
def test_controller_study__what_is_not_there_is_found_before_the_study_is_created(
    changes: dict[str, Any], text: str, tmp_path: Path
) -> None:
    config = study(tmp_path, **changes)
    with pytest.raises((InvalidConfig, UnknownName), match=text):
        Tuning(config)
    assert not (tmp_path / "study.db").exists()


def test_controller_study__default_pruner_waits_for_an_episode_of_each_weather(tmp_path: Path) -> None:
    assert study(tmp_path, weathers=["a", "b"]).pruner.warmup_steps == 2
    assert study(tmp_path, sampler="cma-es").pruner is False
    assert study(tmp_path, pruner=False).pruner is False
    assert study(tmp_path, sampler="cma-es", pruner={"kind": "halving"}).pruner.kind == "halving"


def test_controller_study__recommended_search_space_fits_the_rules(tmp_path: Path) -> None:
    config = study(tmp_path, parameters=RULE_SEARCH_SPACE, sampler="cma-es")
    config.check()


def test_controller_study__example_is_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[2])
    config: Any = load_tuning(Path("examples/tune_rules.yaml"))
    config.check()
    assert config.episodes == 3


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_controller_study__has_the_trials_of_tune_controller_and_writes_a_file_that_evaluates(tmp_path: Path) -> None:
    tuning, processes = Tuning(study(tmp_path)), set()
    process = tuning._process

    def remember(folder: Path) -> Any:
        result = process(folder)
        processes.add(result[0].pid)
        return result

    tuning._process = remember  # type: ignore[method-assign]
    assert tuning.run()
    assert len(processes) == 1  # which kept its environment
    alone = tune_controller("rbc", ARGUMENTS, SPACE, seeds=(0, 1), trials=4)
    assert [(trial.params, trial.value) for trial in tuning.study.trials] == [
        (trial.parameters, trial.value) for trial in alone.trials
    ]
    best = tuning.write_best()
    assert best is not None
    assert yaml12.read_mapping(best) == alone.plain()
    names = {path.name for path in write_results(tuning.study, study(tmp_path))}
    assert {"trials.csv", "history.png", "slices.png", "parallel.png"} <= names
    env = FakeEnv(**FAKE)
    agent = Agent(load_controller(str(best))(env.manifest))
    rewards = [run_episode(env, lambda _: agent.action(env.sample), seed=seed)[0].reward for seed in (0, 1)]
    assert np.mean(rewards) == alone.value


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_controller_study__killed_process_fails_its_trial_which_is_repeated(tmp_path: Path) -> None:
    tuning = Tuning(study(tmp_path, workers=2, retries=1))
    kill_first_process(tuning)
    assert tuning.run()
    assert [trial.state.name for trial in tuning.study.trials] == ["FAIL", *["COMPLETE"] * 4]
    (repeated,) = [trial for trial in tuning.study.trials if "retry_of" in trial.user_attrs]
    assert (repeated.params, repeated.user_attrs["default"]) == ({}, True)


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_controller_study__trials_return_when_what_they_lacked_is_there(tmp_path: Path) -> None:
    """Without a file that is missing, such as one of weather, no trial can be run, not even that of the defaults."""
    code, lacking = tmp_path / "mine.py", tmp_path / "lacking.txt"
    code.write_text(
        "from pathlib import Path\n"
        "from zenostat.controllers import RuleBasedController\n"
        "from zenostat.topics.errors import InvalidConfig\n"
        "class Mine(RuleBasedController):\n"
        "    def __init__(self, manifest, *, margin: float = 0.5):\n"
        f"        if not Path({str(lacking)!r}).exists():\n"
        "            raise InvalidConfig('there is no file lacking.txt')\n"
        "        super().__init__(manifest, margin=margin)\n"
    )
    searched = {"margin": {"low": 0.0, "high": 1.5, "start": 1.0}}
    config = study(tmp_path, controller=f"{code}:Mine", parameters=searched, workers=2)
    with pytest.raises(InvalidConfig, match=r"no trial of the study can be run: .*no file lacking\.txt"):
        Tuning(config).run()
    assert Tuning(config).ended() == 0
    lacking.touch()
    tuning = Tuning(config)
    assert tuning.run()
    complete = [trial.params for trial in tuning.study.trials if trial.state.name == "COMPLETE"]
    assert complete[:2] == [{}, {"margin": 1.0}]
    assert len(complete) == tuning.ended() == tuning.total() == 4


@pytest.mark.slow
@pytest.mark.process
def test_tune_controller__weathers_take_turns_in_a_real_building_and_equal_environments_of_their_own() -> None:
    scenario = "ref-small-office-USA_CO_Denver-continuous-v1"
    week = {"begin": "07-10", "end": "07-12", "steps_per_hour": 2}
    weathers = ("USA_CO_Denver", "USA_FL_Tampa")
    space = {"margin": {"low": 0.0, "high": 1.5}}
    tuned = tune_controller("rbc", {"scenario": scenario, **week}, space, weathers=weathers, trials=3)
    for trial in tuned.trials:
        rewards = []
        for weather in weathers:
            evaluation = evaluate(scenario, ["rbc"], weather=weather, parameters=trial.parameters, **week)
            rewards.append(evaluation.rows[0].result.reward)
        assert trial.value == pytest.approx(np.mean(rewards), rel=1e-9)
