"""Results of the benchmark from several runs and from others: merged, checked, described by a schema."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from support import benchmark_page
from typer.testing import CliRunner

from zenostat.agent_sdk.controllers.training_folder import FORMAT
from zenostat.bridge.recording.file import file_digest
from zenostat.bridge.runtime.processor_time import tree_processor_s
from zenostat.cli.commands import app
from zenostat.lab.benchmark import SETS, Episode, Results, Row, load_results, prepared, rerun, run, submission
from zenostat.lab.benchmark.episodes import jobs
from zenostat.lab.benchmark.merge import merge_results
from zenostat.lab.benchmark.prepared import Preparation, ensure_prepared
from zenostat.lab.benchmark.recipes import is_residual
from zenostat.lab.benchmark.results import NEEDED_VERSIONS, changed_versions
from zenostat.lab.benchmark.results_file import rows_digest, schema
from zenostat.lab.benchmark.run import check_controllers, stale_trainings
from zenostat.lab.benchmark.submission import check_submission
from zenostat.lab.benchmark.tables import Table
from zenostat.topics import VERSION as PRODUCT_VERSION
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, UnknownName

SMOKE = SETS["smoke"]
OFFICE = SMOKE.buildings[0]


def row(episode: Episode, reward: float = -10.0, **changes: Any) -> Row:
    terms = {"cost": reward + 4.0, "gas": 0.0, "peak": -3.0, "comfort": -1.0}
    metrics = {
        "occupied_outside_kh": 1.5, "peak_kw": 1.0, "hvac_electricity_kwh": -terms["cost"] / 0.2,
        "natural_gas_kwh": 0.0, "terminated": 0.0, "electricity_kwh": 50.0, "kpi.ener_tot": -terms["cost"] / 20.0,
    }  # fmt: skip
    values = dict(zip(("controller", "building", "season", "weather", "seed"), episode.key, strict=False))
    fields = {**values, "reward": reward, "terms": terms, "linear": -5.0, "metrics": metrics}
    return Row(**{**fields, "training_seed": episode.training_seed, "processor_s": 1.0, **changes})


def record(controller: str, building: str, number: int | None = 0) -> dict[str, dict[str, Any]]:
    preparation = Preparation(Path(), "smoke", controller, building, "summer", number)
    return {preparation.name: {"configuration": preparation.configuration, "weights": "ab" * 32, "processor_s": 2.0}}


def written(path: Path, rows: Iterable[Row], **changes: Any) -> Path:
    results = Results("smoke", hashes={OFFICE: "ab"}, controllers=check_controllers(["baseline", "rbc"]))
    if "versions" in changes:
        changes["versions"] = {**dict.fromkeys(NEEDED_VERSIONS, "1.0"), **changes["versions"]}
    for name, value in changes.items():
        setattr(results, name, value)
    results.add(rows)
    results.save(path)
    return path


@pytest.fixture
def rows() -> list[Row]:
    episodes = SMOKE.episodes(["baseline", "rbc", "ppo"])
    return [row(episode, {"rbc": -9.0, "ppo": -8.0}.get(episode.controller, -10.0)) for episode in episodes]


TRAININGS = {name: of for building in SMOKE.buildings for name, of in record("ppo", building).items()}


@pytest.fixture
def complete(rows: list[Row], tmp_path: Path) -> Path:
    return written(tmp_path / "complete.json", rows, trainings=TRAININGS)


# Form


def test_benchmark_files__results_meet_the_published_schema(complete: Path) -> None:
    published = json.loads((benchmark_page.FOLDER / "results.schema.json").read_text(encoding="utf-8"))
    assert published == schema(), "zenostat benchmark --schema > docs/benchmark/results.schema.json"
    Draft202012Validator.check_schema(published)
    validator = Draft202012Validator(published)
    content = json.loads(complete.read_text(encoding="utf-8"))
    assert list(validator.iter_errors(content)) == []
    for path in benchmark_page.PUBLISHED.values():
        if path.is_file():
            assert list(validator.iter_errors(json.loads(path.read_text(encoding="utf-8")))) == []
    content["rows"][0]["seed"] = -1
    assert [list(error.path) for error in validator.iter_errors(content)] == [["rows", 0, "seed"]]


def test_benchmark_files__processor_times_do_not_count(rows: list[Row], tmp_path: Path) -> None:
    slower = [dataclasses.replace(one, processor_s=99.0) for one in rows]
    first, second = (load_results(written(tmp_path / "r.json", of)).plain() for of in (rows, slower))
    assert first["rows"] != second["rows"]
    assert first["rows_hash"] == second["rows_hash"]
    assert all(one.same(other) for one, other in zip(rows, slower, strict=True))
    assert not rows[0].same(dataclasses.replace(rows[0], linear=-5.1))


def test_benchmark_files__processor_time_has_that_of_ended_and_running_children() -> None:
    work = "import time; end = time.process_time() + 0.3\nwhile time.process_time() < end: pass\n"
    before = tree_processor_s()
    subprocess.run([sys.executable, "-c", work], check=True)
    with subprocess.Popen([sys.executable, "-c", work + "print(flush=True); input()"], stdin=-1, stdout=-1) as running:
        assert running.stdout is not None
        running.stdout.readline()
        assert tree_processor_s() - before >= 0.6
        running.communicate(b"\n")


# Merging


def test_benchmark_files__parts_are_merged(rows: list[Row], complete: Path, tmp_path: Path) -> None:
    rules = written(tmp_path / "rules.json", [one for one in rows if one.controller != "ppo"])
    parts = [rules]
    for building in SMOKE.buildings:
        chosen = [one for one in rows if one.building == building and one.controller != "rbc"]
        parts.append(written(tmp_path / f"{building}.json", chosen, trainings=record("ppo", building)))
    target = tmp_path / "merged.json"
    options = [part for path in parts for part in ("--merge", str(path))]
    done = CliRunner().invoke(app, ["benchmark", *options, "--out", str(target)])
    assert done.exit_code == 0, done.output
    assert target.read_text(encoding="utf-8") == complete.read_text(encoding="utf-8")
    assert load_results(target).missing(["baseline", "rbc", "ppo"]) == []
    assert len(load_results(rules).missing(["ppo"])) == 2


def test_benchmark_files__parts_of_machines_with_other_libraries_are_merged_in_any_order(
    rows: list[Row], tmp_path: Path
) -> None:
    versions = {"numpy": "2.4.0", "torch": "2.13.0"}
    learned = [one for one in rows if one.controller != "rbc"]
    rules = written(tmp_path / "rules.json", rows[:2], versions={"numpy": "2.4.0"})
    trained = written(tmp_path / "trained.json", learned, versions=versions, trainings=TRAININGS)
    for parts in ([rules, trained], [trained, rules]):
        assert merge_results(parts).versions == dict.fromkeys(NEEDED_VERSIONS, "1.0") | versions


def test_benchmark_files__contradicting_parts_are_refused(rows: list[Row], complete: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    first = rows[0]
    other_weights = {**TRAININGS, f"ppo/{OFFICE}/summer/0": {"configuration": "00", "weights": "00"}}
    for changed, fields, text in (
        ([dataclasses.replace(first, linear=-6.0)], {}, f"different rows of baseline/{OFFICE}/summer"),
        (rows, {"versions": {"numpy": "1.0"}}, "different versions"),
        (rows, {"hashes": {OFFICE: "cd"}}, f"different files {OFFICE}"),
        (rows, {"controllers": check_controllers(["baseline"]) | {"rbc": "ff"}}, "different versions of rbc"),
        (rows, {"controllers": check_controllers(["baseline"])}, "different versions of rbc"),
        (rows, {"trainings": other_weights}, "different trainings ppo/ref-small-office/summer/0"),
    ):
        written(other, changed, **fields)  # type: ignore[arg-type]
        with pytest.raises(InvalidConfig, match=text):
            merge_results([complete, other])


def test_benchmark_files__contradiction_names_the_parts_that_have_it(rows: list[Row], tmp_path: Path) -> None:
    rules = [one for one in rows if one.controller == "rbc"]
    changed = [dataclasses.replace(one, linear=-6.0) for one in rules]
    parts = {"a": rows[:1], "b": rules, "c": changed}
    paths = [written(tmp_path / f"{name}.json", of) for name, of in parts.items()]
    with pytest.raises(InvalidConfig, match=r"/c\.json and \S*/b\.json have different rows of rbc"):
        merge_results(paths)


def test_benchmark_files__shown_controllers_can_be_chosen(complete: Path) -> None:
    shown = CliRunner().invoke(app, ["benchmark", "--show", str(complete), "--controllers", "rbc"])
    assert "rbc" in shown.output
    assert "ppo" not in shown.output


# The page


@pytest.mark.slow
def test_benchmark_files__page_tells_what_the_rows_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick = SETS["quick"]
    rewards = {"baseline": -10.0, "tuned": -9.0, "fixed": -12.0, "ppo": -8.0, "sac": -8.5}
    episodes = [
        episode
        for episode in quick.episodes(rewards)
        if episode.controller != "sac" or episode.task.building == OFFICE  # SAC has one building so far
    ]
    results = Results("quick")
    for episode in episodes:
        worse = 1.5 if episode.controller == "ppo" and episode.task.building == "ref-warehouse" else 0.0
        results.add([row(episode, rewards[episode.controller] - worse)])
    curve = {"steps": [100, 200], "rewards": [-12.0, -9.0]}
    results.trainings[f"ppo/{OFFICE}/summer/0"] = {"configuration": "00", "curve": curve, "processor_s": 7200.0}
    results.save(tmp_path / "quick.json")
    monkeypatch.setattr(benchmark_page, "PUBLISHED", {name: tmp_path / f"{name}.json" for name in SETS})
    monkeypatch.setattr(benchmark_page, "BOUNDS", tmp_path / "bounds")
    text = benchmark_page.page(benchmark_page.PAGE.read_text(encoding="utf-8"))
    assert "There are no intervals: they need at least three weather files and three seeds." in text
    assert "| ppo | 30 | 0.200 | 17.0 |" in text  # in a fifth of the episodes 5 % are saved, in the others 20 %
    assert "| ppo | 0.1000 | 0.1000 | 0.1000 | 0.1000 | 0.1000 | -0.0500 |" in text  # minus `tuned`; last the warehouse
    assert "| sac | 0.150 |  |  |  |  |" in text
    assert "`sac` has 6 of 30 rows so far and is not in the tables." in text
    assert "| ppo | 1.0 | 1 | 7200.0 | 2.0 |" in text
    assert "There are no published rows of version 2 yet." in text  # of the other sets
    figure = benchmark_page.write_curves(results, tmp_path)
    assert figure is not None
    assert figure.is_file()
    benchmark_page.write_curve_table(results, tmp_path / "curves.csv")
    assert (tmp_path / "curves.csv").read_text().splitlines()[1:] == [
        f"ppo/{OFFICE}/summer/0,100,-12.0", f"ppo/{OFFICE}/summer/0,200,-9.0",
    ]  # fmt: skip


@pytest.mark.slow
def test_benchmark_files__page_has_claims_where_there_are_intervals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five trainings of PPO with the same policy: better than `tuned` in four buildings, worse in the warehouse."""
    full, random, results = SETS["full"], np.random.default_rng(0), Results("full")
    noise = {episode.key[1:5]: random.normal() for episode in full.episodes(["baseline"])}
    for episode in full.episodes(["baseline", "tuned", "fixed", "ppo"]):
        saved = {"baseline": 0.0, "tuned": 10.0, "fixed": -10.0, "ppo": 12.0}[episode.controller]
        worse = 4.0 if episode.controller == "ppo" and episode.task.building == "ref-warehouse" else 0.0
        results.add([row(episode, -100.0 + (saved - worse) * (1.0 + 0.1 * noise[episode.key[1:5]]))])
    evaluations = {"steps": [0, 100, 200], "rewards": [-3.0, -1.0, -2.0]}
    for number in range(2):
        results.trainings[f"ppo/{OFFICE}/summer/{number}"] = {"configuration": "00", "evaluations": evaluations}
    results.save(tmp_path / "full.json")
    monkeypatch.setattr(
        benchmark_page, "PUBLISHED", {name: tmp_path / f"{name}.json" for name in benchmark_page.PUBLISHED}
    )
    monkeypatch.setattr(benchmark_page, "BOUNDS", tmp_path / "bounds")
    text = benchmark_page.page(benchmark_page.PAGE.read_text(encoding="utf-8"))
    assert "Better than the baseline control, with the whole interval: `ppo` (0.1" in text
    assert "Worse, with the whole interval: `fixed` (-0.10" in text
    learned = next(line for line in text.splitlines() if line.startswith("| ppo | 0.0") and "of 5 |" in line)
    assert learned.endswith("| 4 and 1 of 5 |")
    assert "Steps at which the policies of the 2 trainings are kept, those of the best evaluation: 2 at 100." in text


# Trainings


def test_benchmark_files__trainings_of_another_recipe_are_stale(complete: Path) -> None:
    results = load_results(complete)
    assert stale_trainings(results) == []
    results.trainings[f"ppo/{OFFICE}/summer/0"]["configuration"] = "00"
    assert stale_trainings(results) == [f"ppo/{OFFICE}/summer/0"]


def test_benchmark_files__finished_tunings_are_taken_from_the_folder_of_policies(tmp_path: Path) -> None:
    preparation = Preparation(tmp_path / "cache", "smoke", "tuned", OFFICE, "summer", None, tmp_path / "policies")
    published = tmp_path / "policies" / f"tuned-{OFFICE}-summer.json"
    published.parent.mkdir()
    content = {"configuration": preparation.configuration, "parameters": {"margin": 0.2}}
    published.write_text(json.dumps(content))
    assert ensure_prepared(preparation)[1] == {**content, "processor_s": None}
    again = dataclasses.replace(preparation, policies=tmp_path / "new")
    ensure_prepared(again)
    assert (tmp_path / "new" / published.name).read_text() == published.read_text()
    published.write_text(json.dumps({**content, "configuration": "00"}))
    with pytest.raises(InvalidConfig, match="was made for another definition"):
        ensure_prepared(dataclasses.replace(preparation, cache=tmp_path / "empty"))


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("[" * 200_000, "has no tuned parameters"),
        ('{"configuration": "ab"}', "it has no parameters"),
        ('{"parameters": {}}', "it has no configuration"),
    ],
)
def test_benchmark_files__damaged_tunings_are_refused(content: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "tuned.json"
    path.write_text(content)
    with pytest.raises(InvalidConfig, match=text):
        prepared.read_record(path)


def test_benchmark_files__curve_has_the_means_of_equal_parts_of_a_training(tmp_path: Path) -> None:
    """25 parts of 40 steps: rewards of the episodes that end in steps 1 to 40, 41 to 80, and so on."""
    file = tmp_path / "curve.csv"
    file.write_text("step,slot,reward,steps\n20,0,-4.0,20\n40,1,-2.0,20\n41,0,-1.0,20\n1003,1,-0.5,20\n")
    assert prepared._curve(file, 1000) == {"steps": [40, 80, 1000], "rewards": [-3.0, -1.0, -0.5]}


def test_benchmark_files__evaluations_have_the_mean_of_their_episodes(tmp_path: Path) -> None:
    file = tmp_path / "evaluations.csv"
    file.write_text("step,seed,reward,other\n0,1,-4.0,9\n0,2,-2.0,9\n500,1,-1.0,9\n500,2,-1.5,\n")
    assert prepared._evaluations(file) == {"steps": [0, 500], "rewards": [-3.0, -1.25]}
    record = {"curve": {"steps": [40], "rewards": [-9.0]}, "evaluations": prepared._evaluations(file)}
    assert benchmark_page.curve_of(record)["steps"] == [0, 500]
    assert benchmark_page.curve_of({**record, "evaluations": None}) == record["curve"]


def test_benchmark_files__training_on_a_rule_waits_for_its_tuning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failed tuning keeps the trainings that build on it from beginning, and no others."""
    assert is_residual("ppo", OFFICE, "summer")
    begun: list[str] = []

    def prepare(preparation: Preparation) -> tuple[Preparation, dict[str, Any]]:
        begun.append(preparation.name)
        if preparation.name == f"tuned/{OFFICE}/summer":
            raise InvalidConfig("no rule")
        return preparation, {"configuration": preparation.configuration, "weights": "00"}

    monkeypatch.setattr(run, "ensure_prepared", prepare)
    monkeypatch.setattr(run, "run_job", lambda job: ([row(episode) for episode in job.episodes], []))
    results, errors = run.run_benchmark("smoke", tmp_path / "results.json", ["ppo"])
    assert begun == [f"tuned/{OFFICE}/summer", "tuned/ref-warehouse/summer", "ppo/ref-warehouse/summer/0"]
    assert errors == [f"tuning tuned/{OFFICE}/summer: no rule"]
    assert [episode.task.building for episode in results.missing(["ppo"])] == [OFFICE]


def test_benchmark_files__a_tuned_rule_is_part_of_what_defines_a_training(tmp_path: Path) -> None:
    training = Preparation(tmp_path, "smoke", "ppo", OFFICE, "summer", 0)
    tuning = training.tuning
    assert tuning is not None
    folders = []
    for margin in (0.1, 0.2):
        content = {"configuration": tuning.configuration, "parameters": {"cooling_margin": margin}}
        tuning.file.write_text(json.dumps(content))
        folders.append(training.folder)
        wrapper = training.fields["wrappers"][-1]
        assert (wrapper["wrapper"], wrapper["parameters"]) == ("ResidualAction", {"cooling_margin": margin})
    assert folders[0] != folders[1]


def test_benchmark_files__own_training_keeps_its_form_of_actions(tmp_path: Path) -> None:
    forms: dict[str, Any] = {"absolute": {}, "relative": {"relative": 2.0}}
    for name, arguments in forms.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "training.yaml").write_text(json.dumps({"algorithm": "ppo", "arguments": arguments}))
        (tmp_path / name / "versions.json").write_text(json.dumps({"format": FORMAT}))
    names = ["baseline", "rbc", *(str(tmp_path / name) for name in forms)]
    of_task = jobs("smoke", [Episode(name, SMOKE.tasks()[0], 1) for name in names], tmp_path)
    assert [[episode.controller for episode in job.episodes] for job in of_task] == [names[:1], names[1:3], names[3:]]


def test_benchmark_files__hash_of_a_controller_has_its_code_and_its_parameters(tmp_path: Path) -> None:
    code, parameters = tmp_path / "mine.py", tmp_path / "best.yaml"
    code.write_text("from zenostat.controllers import RuleBasedController as Mine\n")
    parameters.write_text("controller: rbc\nparameters: {margin: 0.3}\n")
    names = [f"{code}:Mine@{parameters}", f"rbc@{parameters}", f"{code}:Mine"]
    before = run.check_controllers(names)
    parameters.write_text("controller: rbc\nparameters: {margin: 2.3}\n")
    changed = run.check_controllers(names)
    assert [changed[name] != before[name] for name in names] == [True, True, False]
    code.write_text(code.read_text() + "# changed\n")
    assert [run.check_controllers(names)[name] != changed[name] for name in names] == [True, False, True]


@pytest.mark.parametrize("is_folder", [False, True])
def test_benchmark_files__hash_of_a_controller_is_not_that_of_a_file_named_as_its_class(
    is_folder: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, notes = Path("mine.py"), Path("Mine")
    code.write_text("from zenostat.controllers import RuleBasedController as Mine\n")
    names = ["mine.py:Mine", "mine:Mine"]
    if is_folder:
        notes.mkdir()
        Path("mine").mkdir()
    else:
        notes.write_text("notes")
    assert run.check_controllers(names) == {"mine.py:Mine": file_digest(code), "mine:Mine": ""}


@pytest.mark.parametrize("changed", ["best.zip", "best.vecnormalize.pkl", "best.wrappers.yaml", "wrappers.yaml"])
def test_benchmark_files__hash_of_a_training_has_all_that_determines_its_actions(changed: str, tmp_path: Path) -> None:
    model = tmp_path / "best.zip"
    model.write_text("model")
    assert run._controller_digest(f"ppo:{model}") == file_digest(model)
    for name in ("training.yaml", "model.zip", "best.vecnormalize.pkl", "best.wrappers.yaml", "wrappers.yaml"):
        (tmp_path / name).write_text("first")
    names = [str(tmp_path), f"ppo:{model}", str(model)]
    (before,) = {run._controller_digest(name) for name in names}
    (tmp_path / "model.zip").write_text("another step")
    assert {run._controller_digest(name) for name in names} == {before}
    (tmp_path / changed).write_text("second")
    assert len({before, *map(run._controller_digest, names)}) == 2


# Submissions


def test_benchmark_files__citation_names_this_version() -> None:
    citation = yaml12.read_mapping(benchmark_page.PAGE.parents[1] / "CITATION.cff")
    assert citation["version"] == PRODUCT_VERSION
    assert citation["authors"] == [{"name": "The Zenostat developers"}]


@pytest.fixture
def reference(rows: list[Row], tmp_path: Path) -> Path:
    return written(tmp_path / "reference.json", [one for one in rows if one.controller != "ppo"])


def test_benchmark_files__complete_rows_are_accepted(complete: Path, reference: Path) -> None:
    errors, notes = check_submission(complete, reference, {OFFICE: "ab"})
    assert errors == []
    assert len(notes) == 2
    assert notes[0] == "results of the set 'smoke': a submission has those of 'full'"
    assert notes[1].startswith("no rows were run again")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"reward": 0.0, "terms": {}}, "the term 'cost' is missing"),
        ({"terms": {"cost": -6.0, "gas": 0.0, "peak": -3.0, "comfort": 1.0}, "reward": -8.0}, "a term is above 0"),
        ({"terminated": 1.0}, "it ended early"),
        ({"peak_kw": 0.9}, "a peak of 0.9 kW costs other than -3.0 EUR"),
        ({"hvac_electricity_kwh": 10.0}, "10.0 kWh of electricity cannot cost -4.0 EUR"),
        ({"hvac_electricity_kwh": -20.0}, "-20.0 kWh of electricity cannot cost"),
        (
            {
                "terms": {"cost": -4.0, "gas": -1.5, "peak": -3.0, "comfort": -0.5},
                "reward": -9.0,
                "natural_gas_kwh": 10.0,
            },
            "10.0 kWh of gas cannot cost -1.5 EUR",
        ),
        ({"electricity_kwh": 19.0}, "the HVAC's 20.0 kWh exceed the 19.0 kWh of the whole building"),
        ({"electricity_kwh": 72.1}, "a peak of 1.0 kW is below the mean of 72.1 kWh in 72 h"),
        (
            {"terms": {"cost": -4.0, "gas": 0.0, "peak": -3.0, "comfort": 0.0}, "reward": -7.0},
            "1.5 K h outside the comfort band cost nothing",
        ),
        ({"occupied_outside_kh": -3.0}, "-3.0 K h outside the comfort band are below 0"),
        ({"linear": -506.0}, "a linear score of -100.2 is out of range (-100 to 1)"),
        ({"kpi.ener_tot": 0.21}, "20.0 kWh of HVAC energy are not 0.21 kWh/m² in this building"),
    ],
)
def test_benchmark_files__impossible_rows_are_refused(
    changes: dict[str, Any], text: str, rows: list[Row], reference: Path, tmp_path: Path
) -> None:
    learned = next(number for number, one in enumerate(rows) if one.controller == "ppo")
    fields = {name: value for name, value in changes.items() if name in ("reward", "terms", "linear")}
    metrics = {**rows[learned].metrics, **{name: of for name, of in changes.items() if name not in fields}}
    rows[learned] = dataclasses.replace(rows[learned], metrics=metrics, **fields)
    errors, _ = check_submission(written(tmp_path / "s.json", rows, trainings=TRAININGS), reference, {OFFICE: "ab"})
    assert len(errors) == 1
    assert text in errors[0]


def test_benchmark_files__linear_rewards_above_0_are_refused(rows: list[Row], reference: Path, tmp_path: Path) -> None:
    higher = [dataclasses.replace(one, linear=0.1) for one in rows]
    errors, _ = check_submission(written(tmp_path / "s.json", higher, trainings=TRAININGS), reference, {OFFICE: "ab"})
    assert sum("the linear reward 0.1 is above 0" in error for error in errors) == len(rows)


def test_benchmark_files__rounding_of_another_processor_is_a_note(
    rows: list[Row], reference: Path, tmp_path: Path
) -> None:
    other = [dataclasses.replace(one, linear=one.linear * (1 + 1e-12)) for one in rows]
    path = written(tmp_path / "s.json", other, trainings=TRAININGS)
    errors, notes = check_submission(path, reference, {OFFICE: "ab"})
    assert errors == []
    assert "2 rows of the baseline control equal the published ones but for rounding" in notes


def test_benchmark_files__episode_that_is_there_twice_is_refused(complete: Path) -> None:
    content = json.loads(complete.read_text(encoding="utf-8"))
    content["rows"].append(content["rows"][-1])
    content["rows_hash"] = rows_digest(content["rows"])
    complete.write_text(json.dumps(content))
    with pytest.raises(InvalidConfig, match="has 1 episodes more than once"):
        load_results(complete)


def test_benchmark_files__local_part_of_a_version_does_not_count() -> None:
    saved = {"torch": "2.13.0+cpu", "numpy": "2.4.0"}
    assert changed_versions(saved, {"torch": "2.13.0", "numpy": "2.4.1"}) == ["numpy 2.4.0, now 2.4.1"]


@pytest.mark.parametrize("absent", [NEEDED_VERSIONS, ("numpy",)])
def test_benchmark_files__rows_without_versions_are_refused(complete: Path, absent: tuple[str, ...]) -> None:
    content = json.loads(complete.read_text(encoding="utf-8"))
    content["versions"] = {name: of for name, of in content["versions"].items() if name not in absent}
    complete.write_text(json.dumps(content))
    with pytest.raises(InvalidConfig, match=f"versions: {', '.join(absent)} missing"):
        load_results(complete)


def test_benchmark_files__all_errors_of_a_submission_are_listed(
    rows: list[Row], reference: Path, tmp_path: Path
) -> None:
    wrong = [one for one in rows if one.controller != "rbc"][:-1]
    wrong[0] = dataclasses.replace(wrong[0], linear=-6.0)
    wrong[-1] = dataclasses.replace(wrong[-1], reward=30.0)
    stranger = Episode("mine.py:Mine", SMOKE.tasks()[0], 99)
    path = written(tmp_path / "submitted.json", [*wrong, row(stranger)], trainings=record("ppo", OFFICE))
    errors, notes = check_submission(path, reference, {OFFICE: "cd"})
    assert len(notes) == 2
    expected = [
        f"{OFFICE}: not the file of the benchmark",
        "ppo: 1 episodes are missing",
        "mine.py:Mine: 2 episodes are missing",
        "mine.py:Mine/ref-small-office/summer/USA_IL_Chicago/99: no episode of the set",
        "ppo/ref-warehouse/summer/0: its training or tuning is missing",
        "mine.py:Mine: its hash is missing",
        f"ppo/{OFFICE}/summer/USA_IL_Chicago/20001/0: the terms add up to -8.0, the reward is 30.0",
        f"ppo/{OFFICE}/summer/USA_IL_Chicago/20001/0: a score of 4 is out of range",
        f"baseline/{OFFICE}/summer/USA_IL_Chicago/20001: not the published row of the baseline control",
    ]
    assert [text for text in expected if not any(error.startswith(text) for error in errors)] == []
    assert len(errors) == len(expected)


def test_benchmark_files__controllers_of_the_benchmark_with_other_parameters_are_refused(
    rows: list[Row], reference: Path, tmp_path: Path
) -> None:
    other = {**check_controllers(["baseline"]), "rbc": "0" * 64}
    path = written(tmp_path / "submitted.json", rows, trainings=TRAININGS, controllers=other)
    errors, _ = check_submission(path, reference, {})
    assert errors == ["rbc: its hash is not that of the controller of the benchmark"]


@pytest.mark.parametrize(
    ("name", "is_identified"), [("mine.py:Mine", False), ("mine.npz", False), ("mine:Mine", False), ("setback", True)]
)
def test_benchmark_files__empty_hash_identifies_bundled_controllers_alone(
    name: str, is_identified: bool, rows: list[Row], reference: Path, tmp_path: Path
) -> None:
    own = [dataclasses.replace(one, controller=name) if one.controller == "rbc" else one for one in rows]
    hashes = {**check_controllers(["baseline"]), name: ""}
    path = written(tmp_path / "submitted.json", own, trainings=TRAININGS, controllers=hashes)
    errors, _ = check_submission(path, reference, {OFFICE: "ab"})
    assert [error.split(" (")[0] for error in errors] == [f"{name}: its hash is missing"] * (not is_identified)


@pytest.mark.parametrize("name", [" baseline", "base\u200bline", "<img src=x>:A", "a|b.py:A", "a\nb.py:A"])
def test_benchmark_files__names_that_look_otherwise_in_a_table_are_refused(
    name: str, rows: list[Row], reference: Path, tmp_path: Path
) -> None:
    own = [dataclasses.replace(one, controller=name) if one.controller == "rbc" else one for one in rows]
    hashes = {**check_controllers(["baseline"]), name: "ab"}
    path = written(tmp_path / "submitted.json", own, trainings=TRAININGS, controllers=hashes)
    errors, _ = check_submission(path, reference, {OFFICE: "ab"})
    assert len(errors) == 1
    assert errors[0].startswith(f"{name!r}: a name has printable characters")


def test_benchmark_files__names_are_no_markup_in_a_table() -> None:
    name = "<img src=x>|[x](javascript:1)\nmy_file.py:A"
    line = Table("t", ("controller", "rows"), ((name, "1 [0, 2]"),)).markdown().splitlines()[2:]
    assert line == [r"| \<img src=x\>\|\[x\](javascript:1) my_file.py:A | 1 [0, 2] |"]


@pytest.mark.parametrize("library", ["optuna", "scipy", "stable-baselines3", "torch"])
def test_benchmark_files__versions_of_what_trains_do_not_matter_to_the_baseline_control(
    library: str, rows: list[Row], complete: Path, tmp_path: Path
) -> None:
    other = [dataclasses.replace(one, linear=-5.1) for one in rows]
    versions = load_results(complete).versions | {library: "1.0"}
    reference = written(tmp_path / "reference.json", other, versions=versions)
    errors, notes = check_submission(complete, reference, {})
    assert [error.partition(": ")[2] for error in errors] == ["not the published row of the baseline control"] * 2
    assert not any(library in note for note in notes)


@pytest.mark.parametrize(("factor", "is_explained"), [(1.005, True), (1.02, False), (0.5, False)])
def test_benchmark_files__baseline_of_other_versions_is_compared_roughly(
    factor: float, is_explained: bool, rows: list[Row], complete: Path, tmp_path: Path
) -> None:
    older = [dataclasses.replace(one, linear=factor * one.linear) for one in rows]
    reference = written(tmp_path / "reference.json", older, versions={"numpy": "1.0"})
    errors, notes = check_submission(complete, reference, {})
    assert [error.partition(": ")[2].split(",")[0] for error in errors] == ["a linear reward of -5.0"] * 2 * (
        not is_explained
    )
    assert any(note.startswith("version of numpy 1.0, now ") for note in notes)
    assert any("were compared within 1 % only" in note for note in notes)


def test_benchmark_files__submission_is_checked_without_published_rows(
    complete: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    errors, notes = check_submission(complete, None, {OFFICE: "cd"})
    assert errors == [f"{OFFICE}: not the file of the benchmark"]
    assert len(notes) == 3
    assert f"not compared: no published rows are in {Path('docs', 'benchmark')}" in notes[0]
    with pytest.raises(UnknownName, match="there is no file"):
        check_submission(complete, tmp_path / "none.json", {})


def test_benchmark_files__sample_is_drawn_from_the_seed_and_runs_no_unnamed_code(
    rows: list[Row], reference: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    episodes = [Episode("evil.py:Evil", task, seed) for task in SMOKE.tasks() for seed in SMOKE.seeds]
    path = written(
        tmp_path / "submitted.json", [*rows, *map(row, episodes)], trainings=TRAININGS,
        controllers={**check_controllers(["baseline", "rbc"]), "evil.py:Evil": "02"},
    )  # fmt: skip
    drawn: list[list[str]] = []
    places: list[list[Any]] = []

    def run_again(_: Results, chosen: Iterable[Row], **__: Any) -> list[str]:
        drawn.append([one.controller for one in chosen])
        places.append(list(chosen))
        return []

    monkeypatch.setattr(submission, "check_rows", run_again)
    for seed in (1, 1, 2):
        errors, notes = check_submission(path, reference, {}, sample=4, sample_seed=seed)
        assert errors == []
        assert any("evil.py:Evil: not part of the benchmark" in note for note in notes)
    assert drawn == [[], [], []]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text(
        "class Evil:\n    def __init__(self, manifest): ...\n    def act(self, sample): ...\n"
    )
    errors, notes = check_submission(path, reference, {}, sample=1, controllers=["evil.py:Evil"])
    assert errors == ["evil.py:Evil: its hash is not that of the present file"]
    assert drawn[-1] == ["evil.py:Evil"]  # rows of the submission alone
    seeds = [note.partition("--sample-seed ")[2] for note in notes if "--sample-seed" in note]
    check_submission(path, reference, {}, sample=1, controllers=["evil.py:Evil"], sample_seed=int(seeds[0]))
    assert places[-1] == places[-2]
    with pytest.raises(InvalidConfig, match=r"rows of evil\.py:Evil, which is not part of the benchmark"):
        rerun.check(path)


def test_benchmark_files__command_checks_a_submission(complete: Path, reference: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("zenostat.cli.benchmark.file_hashes", lambda _: {})
    options = ["benchmark", "--submit-check", str(complete), "--reference", str(reference)]
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 0, done.output
    assert "no errors; the notes say what was not checked" in done.output
    missing = CliRunner().invoke(app, ["benchmark", "--submit-check", str(reference.parent / "none.json")])
    assert missing.exit_code != 0
