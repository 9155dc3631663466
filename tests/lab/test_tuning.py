"""Studies: search spaces, studies that exist, lost databases, and the processes of trials."""

import re
import sqlite3
import subprocess
import sys
import threading
import warnings
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zenostat.topics.errors import InvalidConfig

optuna = pytest.importorskip("optuna")
pytest.importorskip("stable_baselines3")

from support.tuning import kill_first_process  # noqa: E402

from zenostat.lab.tuning.search_space import distribution  # noqa: E402
from zenostat.lab.tuning.study import Tuning, open_study, reason_of  # noqa: E402
from zenostat.lab.tuning.study_config import Pruner, Range  # noqa: E402
from zenostat.lab.tuning.study_figures import write_results  # noqa: E402
from zenostat.lab.tuning.study_storage import make_pruner  # noqa: E402
from zenostat.lab.tuning.tuning_file import read_tuning  # noqa: E402

TRAINING: dict[str, Any] = {
    "algorithm": "a2c", "scenario": "Fake-v1", "steps": 60, "threads": 1,
    "arguments": {"zones": 2, "begin": "07-03", "end": "07-03", "steps_per_hour": 1},
    "parameters": {"policy_kwargs": {"net_arch": [8]}}, "evaluation": {"every_steps": 30},
}  # fmt: skip
SEARCHED: dict[str, Any] = {
    "parameters.learning_rate": {"low": 1e-4, "high": 1e-2, "log": True},
    "parameters.n_steps": [5, 10],
}


def study(output: Path, **changes: Any) -> Any:
    fields = {"study": "s", "training": TRAINING, "parameters": SEARCHED, "trials": 3, "pruner": False}
    return read_tuning({**fields, "output": str(output), **changes})


def test_tuning__grid_has_all_combinations_in_order(tmp_path: Path) -> None:
    searched = {"parameters.n_steps": {"low": 5, "high": 15, "step": 5}, "slots": [1, 2]}
    config = study(tmp_path, parameters=searched, sampler="grid", trials=None)
    points = [(5, 1), (5, 2), (10, 1), (10, 2), (15, 1), (15, 2)]
    assert [tuple(point.values()) for point in config.grid()] == points
    assert config.trials == 6
    queued = [trial.system_attrs["fixed_params"] for trial in open_study(config).trials]
    assert [tuple(point.values()) for point in queued] == points
    with pytest.raises(InvalidConfig, match=r"parameters\.learning_rate: a grid needs choices"):
        study(tmp_path, sampler="grid", trials=None)
    for low, high, step in ((0, 10**9, 1), (0.0, 1.0, 1e-300), (0, 10**30, 1)):
        endless = {"parameters.gamma": {"low": low, "high": high, "step": step}}
        with pytest.raises(InvalidConfig, match=r"parameters\.gamma: more than 100,000 values"):
            study(tmp_path, parameters=endless, sampler="grid", trials=None)
    many = {f"parameters.{name}": {"low": 1, "high": 1000, "step": 1} for name in ("n_steps", "n_epochs")}
    with pytest.raises(InvalidConfig, match="the grid has 1,000,000 points; at most 100,000"):
        study(tmp_path, parameters=many, sampler="grid", trials=None)
    with pytest.raises(InvalidConfig, match="trials: 3, but a grid has all of its 6 points"):
        study(tmp_path, parameters=searched, sampler="grid", trials=3)


def test_tuning__best_training_has_its_references_again(tmp_path: Path) -> None:
    """Trials have none, since these are the same in each."""
    config = study(tmp_path)
    values = {"parameters.learning_rate": 1e-3, "parameters.n_steps": 5}
    assert config.trial_fields(values, tmp_path)["training"]["evaluation"]["references"] == []
    assert config.best_fields(values)["evaluation"]["references"] == ["baseline"]


@pytest.mark.parametrize(
    ("searched", "expected"),
    [
        ({"low": 1, "high": 8}, optuna.distributions.IntDistribution(1, 8)),
        ({"low": 1, "high": 9, "step": 4}, optuna.distributions.IntDistribution(1, 9, step=4)),
        ({"low": 1, "high": 8, "step": 4}, optuna.distributions.IntDistribution(1, 5, step=4)),
        ({"low": 0.0, "high": 3.0, "step": 0.7}, optuna.distributions.FloatDistribution(0.0, 2.8, step=0.7)),
        ({"low": 0.5, "high": 1}, optuna.distributions.FloatDistribution(0.5, 1.0)),
        ({"low": 1e-5, "high": 1e-2, "log": True}, optuna.distributions.FloatDistribution(1e-5, 1e-2, log=True)),
        ({"choices": [[8], [8, 8]]}, optuna.distributions.CategoricalDistribution(("[8]", "[8, 8]"))),
    ],
)
def test_tuning__ranges_are_the_distributions_of_optuna(searched: dict[str, Any], expected: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert distribution(Range.model_validate(searched)) == expected


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"parameters": {"parameters.gamma": {"low": 1.0}}}, "either low and high, or choices expected"),
        ({"parameters": {"parameters.gamma": {"low": 1.0, "high": 0.5}}}, "low is above high"),
        ({"parameters": {"parameters.gamma": {"low": 0.5, "high": 1.0, "step": -0.1}}}, r"step: .*greater than 0"),
        ({"parameters": {"parameters.gamma": {"low": 1, "high": 9, "step": 0}}}, r"step: .*greater than 0"),
        ({"parameters": {"parameters.gamma": {"low": 0.0, "high": 0.5, "log": True}}}, "log needs a low above 0"),
        ({"trials": None}, "trials: it is missing"),
        ({"tirals": 3}, "did you mean 'trials'"),
        ({"training": {**TRAINING, "evaluation": False}}, "a study compares evaluations"),
        ({"training": {**TRAINING, "evaluation": {"every_steps": 61}}}, "every_steps: 61 is above the 60 steps"),
        ({"metric": "kpi.cost_tot"}, "the study: metric: kpi.cost_tot needs prices"),
        ({"training": {**TRAINING, "step": 3}}, "step: there is no such field; did you mean 'steps'"),
    ],
)
def test_tuning__bad_input_is_one_sentence(changes: dict[str, Any], text: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=text):
        study(tmp_path, **changes)


def test_tuning__first_evaluation_may_come_before_or_with_the_first_or_last_step(tmp_path: Path) -> None:
    for evaluation in ({"every_steps": 60}, {"every_steps": 61, "at_start": True}, {"every_episodes": 99}):
        study(tmp_path, training={**TRAINING, "evaluation": evaluation})
    late = {**TRAINING, "evaluation": {"every_steps": 61}}
    study(tmp_path, training=late, parameters={"steps": {"low": 50, "high": 100}})


def test_tuning__parameter_that_the_algorithm_does_not_have_is_found_before_the_study_is_created(
    tmp_path: Path,
) -> None:
    config = study(tmp_path, parameters={"parameters.gama": [0.9]})
    with pytest.raises(InvalidConfig, match="a2c has no 'gama'; did you mean 'gamma'"):
        Tuning(config)
    assert not (tmp_path / "study.db").exists()


def test_tuning__study_that_exists_with_other_settings_is_one_sentence(tmp_path: Path) -> None:
    open_study(study(tmp_path))
    assert len(open_study(study(tmp_path, trials=7, workers=2)).trials) == 0  # these may differ
    with pytest.raises(InvalidConfig, match=r"the study 's' exists .*with other settings \(seed\)"):
        open_study(study(tmp_path, seed=1))


def test_tuning__study_that_exists_with_other_files_is_one_sentence(tmp_path: Path) -> None:
    scenario, model, controller = (tmp_path / name for name in ("s.yaml", "m.idf", "own.py"))
    for path in (scenario, model, controller):
        path.write_text("1")
    arguments = {"building": str(model), "steps_per_hour": 1}
    of_controller = {"controller": f"{controller}:Own", "scenario": str(scenario), "arguments": arguments}
    of_controller |= {"study": "c", "parameters": {"a": [1, 2]}, "trials": 3, "output": str(tmp_path)}
    training = {**TRAINING, "scenario": str(scenario), "arguments": arguments}
    configs = [read_tuning(of_controller), study(tmp_path, training=training)]
    for config in configs:
        open_study(config)
        open_study(config)
    for path, concerned in ((controller, configs[:1]), (model, configs), (scenario, configs)):
        path.write_text("2")
        for config in concerned:
            with pytest.raises(InvalidConfig, match=f"exists .*with other settings .*content of {path}"):
                open_study(config)


def test_open_study__waits_for_the_machine_that_is_creating_the_study(tmp_path: Path) -> None:
    config = study(tmp_path)
    created = open_study(config)
    identity = created.user_attrs["zenostat"]
    created.set_user_attr("zenostat", {})  # as between the creation and what is written after it
    threading.Timer(0.5, created.set_user_attr, ["zenostat", identity]).start()
    assert open_study(config).study_name == "s"


@pytest.mark.parametrize(("low", "high", "step"), [(0.1, 0.3, 0.1), (0.0, 0.7, 0.1), (1.1, 3.3, 1.1), (0, 9, 3)])
def test_range__grid_ends_at_its_high_end(low: float, high: float, step: float) -> None:
    values = Range(low=low, high=high, step=step).values()
    assert values[-1] == high
    assert values == pytest.approx(list(np.linspace(low, high, len(values))))


@pytest.mark.parametrize(("direction", "sign"), [("maximize", 1.0), ("minimize", -1.0)])
@pytest.mark.parametrize(
    ("values", "pruned"), [([-11.0, -30.0], True), ([-14.0, -27.0], False), ([-11.0, -28.0], False), ([-14.0], False)]
)
def test_median_pruner__compares_the_value_at_the_step(
    direction: str, sign: float, values: list[float], *, pruned: bool
) -> None:
    study = optuna.create_study(direction=direction, pruner=make_pruner(Pruner(startup_trials=3, warmup_steps=2)))
    for means in ([-13.0, -27.0], [-12.0, -28.0], [-12.5, -29.0]):  # first in mild weather, then in all
        finished = study.ask()
        for step, value in enumerate(means, 1):
            finished.report(sign * value, step)
        study.tell(finished, sign * means[-1])
    trial = study.ask()
    for step, value in enumerate(values, 1):
        trial.report(sign * value, step)
    assert bool(trial.should_prune()) is pruned


@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_tuning__interruptions_are_no_retries(tmp_path: Path) -> None:
    tuning = Tuning(study(tmp_path, retries=1))
    trial = tuning.study.ask()
    for _ in range(3):
        tuning.study.enqueue_trial({}, user_attrs={"retry_of": trial.number, "interrupted": True})
    assert tuning._may_retry(trial)
    tuning.study.enqueue_trial({}, user_attrs={"retry_of": trial.number})
    assert not tuning._may_retry(trial)


def test_tuning__total_counts_trials_beyond_those_of_the_file(tmp_path: Path) -> None:
    for _ in range(4):
        open_study(study(tmp_path)).add_trial(optuna.trial.create_trial(value=1.0))
    tuning = Tuning(study(tmp_path, trials=3))
    assert (tuning.ended(), tuning.total()) == (4, 4)
    assert Tuning(study(tmp_path, trials=7)).total() == 7


@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_tuning__invalid_combination_fails_its_trial_alone(tmp_path: Path) -> None:
    ended: list[Any] = []
    tuning = Tuning(study(tmp_path, parameters={"slots": {"low": 1, "high": 500}}, sampler="random"), ended.append)
    tuning.study.enqueue_trial({"slots": 400})
    tuning._start()
    assert tuning.processes == []
    (trial,) = ended
    assert trial.state is optuna.trial.TrialState.FAIL
    assert "slots" in reason_of(trial)
    for _ in range(2):
        tuning.study.enqueue_trial({"slots": 400})
    tuning._start()
    with pytest.raises(InvalidConfig, match=r"no trial of the study can be run: .*slots"):
        tuning._start()


@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_tuning__first_trials_that_are_all_invalid_are_queued_again(tmp_path: Path) -> None:
    tuning = Tuning(study(tmp_path, parameters={"slots": {"low": 1, "high": 500}}, sampler="random"))
    for slots in (400, 401, 402):
        tuning.study.enqueue_trial({"slots": slots})
    for _ in range(2):
        with pytest.raises(InvalidConfig, match=r"no trial of the study can be run: .*slots"):
            Tuning(study(tmp_path, parameters={"slots": {"low": 1, "high": 500}}, sampler="random")).run()
        waiting = [trial for trial in tuning.study.trials if trial.state is optuna.trial.TrialState.WAITING]
        assert [trial.system_attrs["fixed_params"]["slots"] for trial in waiting] == [400, 401, 402]
        assert [trial.user_attrs["retry_of"] for trial in waiting] == [0, 1, 2]
        assert tuning.ended() == 0


def instant_process(folder: Path) -> tuple[Any, Path]:
    """Start a process that ends the trial of a folder at once."""
    code = 'import pathlib, sys; pathlib.Path(sys.argv[1]).write_text(\'{"state": "complete", "value": 1.0}\')'
    return subprocess.Popen([sys.executable, "-c", code, str(folder / "result.json")]), folder / "log.txt"


def tuning_with_instant_trials(*arguments: Any) -> Tuning:
    tuning = Tuning(*arguments)
    tuning._process = instant_process  # type: ignore[method-assign]
    return tuning


@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
@pytest.mark.parametrize("retries", [0, 1])
def test_tuning__trial_of_a_command_that_was_killed_is_lost_and_repeated(tmp_path: Path, retries: int) -> None:
    killed = tuning_with_instant_trials(study(tmp_path, retries=retries))
    killed._start()  # and is never heard of again
    killed._workers[0].process.wait()
    with closing(sqlite3.connect(tmp_path / "study.db")) as database, database:
        assert database.execute("update trial_heartbeats set heartbeat = datetime('now', '-121 seconds')").rowcount == 1
    ended: list[Any] = []
    tuning = tuning_with_instant_trials(study(tmp_path, retries=retries), ended.append)
    assert tuning.run()
    states = [trial.state.name for trial in tuning.study.trials]
    assert states == ["FAIL", *["COMPLETE"] * (2 + retries)]
    lost, *others = tuning.study.trials
    assert reason_of(lost) == "the machine that ran it was lost"
    assert [trial.number for trial in ended] == list(range(3 + retries))
    assert [trial.params for trial in others if "retry_of" in trial.user_attrs] == [lost.params] * retries
    assert tuning.ended() == 3


@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_tuning__waits_for_trials_that_run_elsewhere(tmp_path: Path) -> None:
    other, stop = tuning_with_instant_trials(study(tmp_path, trials=1)), threading.Event()
    other._start()
    assert not Tuning(study(tmp_path, trials=1), None, stop.set).run(stop)
    other._workers[0].process.wait()
    assert other.run()
    assert Tuning(study(tmp_path, trials=1)).run()


def test_tuning__database_that_is_not_there_is_one_sentence_without_its_password(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    url = "postgresql://me:secret@127.0.0.1:1/none?connect_timeout=2"
    with pytest.raises(
        InvalidConfig, match=r"the database postgresql://me@127\.0\.0\.1:1/none.* cannot be used"
    ) as error:
        open_study(study(tmp_path, storage=url))
    assert "secret" not in str(error.value)


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("postgresql://me:a@b/secret@127.0.0.1:1/none", "the database postgresql://me@127.0.0.1:1/none cannot be used"),
        ("postgresql://me@127.0.0.1:1/none?password=secret", "none?password=... cannot be used"),
        ("postgres://me:secret@127.0.0.1:1/none", "the database postgres://me@127.0.0.1:1/none cannot be used"),
        ("study.db", "storage: study.db: Could not parse SQLAlchemy URL"),
        ("oracel://me:secret@host/none", "storage: oracel://me@host/none: Can't load plugin"),
    ],
)
def test_tuning__errors_name_the_database_as_the_user_did(url: str, text: str, tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    with pytest.raises(InvalidConfig, match=re.escape(text)) as error:
        open_study(study(tmp_path, storage=url))
    assert "secret" not in str(error.value)


@pytest.mark.variants
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
@pytest.mark.parametrize("sampler", ["tpe", "random"])
def test_tuning__processes_with_one_seed_draw_what_one_process_draws(sampler: str, tmp_path: Path) -> None:
    config, other = study(tmp_path / "a", sampler=sampler), study(tmp_path / "b", sampler=sampler)
    searched = {name: distribution(parameter) for name, parameter in config.parameters.items()}
    alone = open_study(other)
    expected = [alone.ask(searched).params for _ in range(4)]
    assert len({params["parameters.learning_rate"] for params in expected}) == 4
    first, second = open_study(config), open_study(config)
    interrupted = first.ask(searched)
    first.tell(interrupted, state=optuna.trial.TrialState.FAIL)
    first.enqueue_trial(interrupted.params, user_attrs={"retry_of": interrupted.number})
    drawn = [process.ask(searched).params for process in (second, first, second, open_study(config))]
    assert drawn == expected


@pytest.mark.slow
@pytest.mark.process
def test_tuning__killed_process_fails_its_trial_and_no_other(tmp_path: Path) -> None:
    ended: list[Any] = []
    tuning = Tuning(study(tmp_path, workers=2, retries=1), ended.append)
    kill_first_process(tuning)
    assert tuning.run()
    states = [trial.state.name for trial in tuning.study.trials]
    assert states == ["FAIL", "COMPLETE", "COMPLETE", "COMPLETE"]
    assert tuning.study.trials[0].user_attrs["reason"].startswith("its process ended with -9")
    repeated = next(trial for trial in tuning.study.trials if "retry_of" in trial.user_attrs)
    assert repeated.params == tuning.study.trials[0].params
    assert len(ended) == 4
    names = {path.name for path in write_results(tuning.study, study(tmp_path))}
    assert {"trials.csv", "history.png", "slices.png", "parallel.png"} <= names
    best = tuning.write_best()
    assert best.name == "best.yaml"


@pytest.mark.slow
@pytest.mark.process
def test_tuning__stopped_study_repeats_its_trials_and_gives_the_same_as_another(tmp_path: Path) -> None:
    stop = threading.Event()
    tuning = Tuning(study(tmp_path / "a", trials=2))
    start = tuning._start

    def stop_at_once() -> None:
        start()
        stop.set()

    tuning._start = stop_at_once  # type: ignore[method-assign]
    assert not tuning.run(stop)
    assert [trial.state.name for trial in tuning.study.trials] == ["FAIL", "WAITING"]
    assert tuning.processes == []
    again, other = Tuning(study(tmp_path / "a", trials=1)), Tuning(study(tmp_path / "b", trials=1))
    assert again.run()
    assert other.run()
    (first,) = other.study.trials
    assert (again.study.trials[1].params, again.study.trials[1].value) == (first.params, first.value)
