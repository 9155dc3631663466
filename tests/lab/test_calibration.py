"""Calibration: errors by hand calculation, trials that repeat to the bit, and what is determined."""

from __future__ import annotations

import json
import math
import multiprocessing
from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.calibration_model import HELD_OUT, SERIES, SUMMER, TRUTH, WINTER, Interrupted, LinearModel, write_measured

from zenostat.lab.calibration.config import Calibration, read_calibration
from zenostat.lab.calibration.headings import read_headings
from zenostat.lab.calibration.measured import MeasuredData, read_measured
from zenostat.metrics.calibration_errors import HOURLY, MONTHLY, fit_errors
from zenostat.topics.errors import InvalidConfig, SimulatorError

pytest.importorskip("optuna")

from zenostat.lab.calibration.calibrate import CalibrationResult, calibrate
from zenostat.lab.calibration.determination import Linearization, determine

SPACE: dict[str, Any] = {
    "day": {"edit": "lighting", "low": 0.5, "high": 2.0, "start": 1.0},
    "night": {"edit": "equipment", "low": 0.5, "high": 2.0, "start": 1.0},
    "offset": {"edit": "heating_setpoint", "low": -3.0, "high": 3.0, "start": 0.0},
}


def configuration(output: Path, **changes: Any) -> Calibration:
    fields: dict[str, Any] = {
        "timestamps": "end", "periods": [WINTER, SUMMER], "held_out": [HELD_OUT], "parameters": SPACE, "trials": 21,
        "output": str(output),
    }  # fmt: skip
    return read_calibration({**fields, **changes})


def measurements(path: Path, config: Calibration) -> MeasuredData:
    _, headings = read_headings(path, config)
    return read_measured(path, config, headings, SERIES, -7.0)


def run(output: Path, model: LinearModel | None = None, noise: float = 0.0, **changes: Any) -> CalibrationResult:
    config = configuration(output, **changes)
    data = measurements(write_measured(output.with_suffix(".csv"), noise=noise), config)
    return calibrate(config, data, model or LinearModel())


# The file


def test_configuration__periods_are_days(tmp_path: Path) -> None:
    for day in (datetime(2017, 1, 9, 12), "2017-01-09T12:00", 3):
        with pytest.raises(InvalidConfig, match=r"periods.*days as 2017-01-09 expected, got 2017-01-02 and "):
            configuration(tmp_path, periods=[[date(2017, 1, 2), day]])


def test_configuration__first_trial_is_the_model_as_it_is_where_the_steps_have_it(tmp_path: Path) -> None:
    ranges = {"low": 0.5, "high": 2.0}
    space = {
        "a": {"edit": "lighting", **ranges, "step": 0.1}, "b": {"edit": "equipment", **ranges, "step": 0.4},
        "c": {"edit": "infiltration", **ranges}, "d": {"edit": "cooling_setpoint", **ranges},
    }  # fmt: skip
    config = configuration(tmp_path, parameters=space).with_starts(dict.fromkeys("abc", 1.0) | {"d": 0.0})
    assert {name: parameter.start for name, parameter in config.parameters.items()} == {
        "a": 1.0, "b": None, "c": 1.0, "d": None,
    }  # fmt: skip


# Formulas


def test_fit_errors__are_those_of_a_hand_calculation() -> None:
    # differences 1, -1, 2, 0: sum 2, squares 6; mean 5, n - p = 3
    errors = fit_errors(np.array([4.0, 4.0, 6.0, 6.0]), np.array([3.0, 5.0, 4.0, 6.0]))
    assert errors.mean == 5.0
    assert errors.nmbe_percent == pytest.approx(100 * 2 / (3 * 5))  # 13.33 %: the model underestimates
    assert errors.cv_rmse_percent == pytest.approx(100 * math.sqrt(6 / 3) / 5)  # 28.28 %
    assert not errors.is_within(HOURLY)  # by the bias alone
    assert fit_errors(np.array([4.0, 4.0, 6.0, 6.0]), np.array([3.0, 5.0, 4.0, 6.0]), 0).mbe == 0.5
    assert math.isnan(fit_errors(np.array([4.0]), np.array([3.0])).rmse)  # one value, and one is adjustable
    assert (HOURLY.cv_rmse_percent, HOURLY.nmbe_percent) == (30.0, 10.0)
    assert (MONTHLY.cv_rmse_percent, MONTHLY.nmbe_percent) == (15.0, 5.0)


def test_calibrate__errors_of_rows_months_and_objective_are_those_of_a_hand_calculation(tmp_path: Path) -> None:
    result = run(tmp_path / "out", trials=1, sampler="random", batch=1, pruner=False, refine=0)
    before = result.fits["before"]
    electricity, room = before.columns
    # 60 h by day with 7 - 5 kWh, 84 h by night with 1.4 - 2 kWh
    measured = 60 * 7.0 + 84 * 1.4
    assert electricity.rows.count == 144
    assert electricity.rows.mean == pytest.approx(measured / 144)
    assert electricity.rows.mbe == pytest.approx((60 * 2.0 - 84 * 0.6) / 143)
    assert electricity.rows.rmse == pytest.approx(math.sqrt((60 * 4.0 + 84 * 0.36) / 143))
    # January and July are equal, each half of the sum
    assert electricity.months is not None
    assert (electricity.months.count, electricity.months.mean) == (2, pytest.approx(measured / 2))
    assert electricity.months.nmbe_percent == pytest.approx(100 * (60 * 2.0 - 84 * 0.6) / (measured / 2))
    assert (room.rows.mbe, room.rows.rmse) == (
        pytest.approx(1.5 * 144 / 143),
        pytest.approx(1.5 * math.sqrt(144 / 143)),
    )
    squares = [(electricity.rows.cv_rmse_percent / 30) ** 2, (electricity.rows.nmbe_percent / 10) ** 2]
    squares += [room.rows.rmse**2, room.rows.mbe**2]  # a tolerance of 1 K
    assert before.error == pytest.approx(math.sqrt(sum(squares) / 2))
    assert set(result.fits) == {"before", "after", "held-out before", "held-out after"}
    assert result.trials[0] == ({"day": 1.0, "night": 1.0, "offset": 0.0}, before.error)  # the model as it is


def test_determine__interval_reaches_the_optimum_of_the_linearized_model(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    best = {"day": 1.25, "night": 1.25, "offset": 0.0}  # the middle of each range
    step, deviations = np.array([0.2, -0.7, 0.0]), np.array([0.0, 0.05, 0.05])
    linear = Linearization(step, np.diag(deviations**2), weighted=step, curvature=np.eye(3), gradient=step)
    determined = determine(config, best, linear, [(best, 1.0)])
    ranges = [tuple(config.parameters[each.name].to_unit(end) for end in each.interval) for each in determined]
    half = 0.05 * 1.959964
    expected = [(0.5, 0.7), (0.0, 0.5 + half), (0.5 - half, 0.5 + half)]  # one step leads beyond the range
    assert [end for each in ranges for end in each] == pytest.approx([end for each in expected for end in each])
    assert [each.is_determined for each in determined] == [True, False, True]


# Trials


@pytest.mark.slow
def test_calibrate__recovers_the_truth_and_tells_what_is_not_determined(tmp_path: Path) -> None:
    nothing = {"edit": "people", "low": 0.0, "high": 1.0}  # a parameter on which nothing depends
    result = run(tmp_path / "out", noise=0.02, trials=28, parameters={**SPACE, "nothing": nothing})
    assert result.values["day"] == pytest.approx(TRUTH["day"], abs=0.1)
    assert result.values["night"] == pytest.approx(TRUTH["night"], abs=0.1)
    assert result.values["offset"] == pytest.approx(TRUTH["offset"], abs=0.2)
    determined = {each.name: each for each in result.parameters}
    assert [each.is_determined for each in result.parameters] == [True, True, True, False]
    for name, truth in TRUTH.items():
        assert determined[name].low <= truth <= determined[name].high
    low, high = determined["nothing"].interval
    assert high - low > 0.9  # nothing but the range itself is known
    assert result.fits["held-out after"].error < 0.2 * result.fits["held-out before"].error
    assert result.states == {"complete": 32}  # whole batches of 8


@pytest.mark.parametrize(("fails_below", "verdict"), [
    (-9.0, "determined"), (1.1, "not determined; values nearby cannot be simulated"),
])  # fmt: skip
def test_calibrate__simulations_that_fail_nearby_do_not_end_it(
    tmp_path: Path, fails_below: float, verdict: str
) -> None:
    class Fragile(LinearModel):
        def simulate(self, values: Any, days: Any) -> Any:
            offset = values.get("offset", 1.5)
            if not fails_below <= offset <= 1.6:
                raise SimulatorError("too cold or too warm")
            return super().simulate(values, days)

    space = {**SPACE, "offset": {**SPACE["offset"], "start": 1.3}}
    result = run(tmp_path / "out", Fragile(), noise=0.02, trials=40, parameters=space)
    day, _, offset = result.parameters
    assert (day.verdict, offset.verdict) == ("determined", verdict)
    assert offset.value == pytest.approx(TRUTH["offset"], abs=0.2 if verdict == "determined" else 0.5)
    assert result.states["fail"] > 0


def test_calibrate__whole_ends_are_a_range_of_all_numbers_and_steps_hold_for_the_result(tmp_path: Path) -> None:
    parameters = {
        "day": {"edit": "lighting", "low": 1, "high": 2},
        "offset": {"edit": "heating_setpoint", "low": -2, "high": 2, "step": 0.25},
    }
    result = run(tmp_path / "out", parameters=parameters, trials=12)
    tried = [each.values for each in result.ended]
    assert any(values["day"] % 1.0 for values in tried)
    assert all(values["offset"] % 0.25 == 0.0 for values in (*tried, result.values))
    assert result.values["offset"] == TRUTH["offset"]


def test_calibrate__continues_to_the_bit_after_any_interruption(tmp_path: Path) -> None:
    whole = run(tmp_path / "whole", trials=6, batch=3, sampler="tpe")
    for left in (1, 6, 10, 16):  # before the study, in both batches, and after it
        with pytest.raises(Interrupted):
            run(tmp_path / "parts", LinearModel(left), trials=6, batch=3, sampler="tpe")
    parts = run(tmp_path / "parts", trials=6, batch=3, sampler="tpe")
    assert parts.trials == whole.trials
    assert parts.plain() == whole.plain()


def test_calibrate__does_not_depend_on_the_parts_in_which_trials_are_asked_for(tmp_path: Path) -> None:
    run(tmp_path / "parts", trials=2, batch=3, sampler="tpe")
    parts, whole = (run(tmp_path / name, trials=6, batch=3, sampler="tpe") for name in ("parts", "whole"))
    assert parts.trials == whole.trials


def test_calibrate__median_pruner_ends_trials_after_a_period(tmp_path: Path) -> None:
    pruner = {"kind": "median", "startup_trials": 4}
    result = run(tmp_path / "out", sampler="random", trials=12, batch=4, pruner=pruner)
    assert result.states["pruned"] > 0
    assert sum(result.states.values()) == 12
    reasons = [json.loads(file.read_text()) for file in sorted((tmp_path / "out" / "trials").iterdir())]
    first = [each["state"] for each in reasons[:4]]
    assert first == ["complete"] * 4  # none is ended before four have finished
    assert all(len(each["stages"]) == 1 for each in reasons if each["state"] == "pruned")


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("sampler", ["cma-es", "tpe"])
def test_calibrate__is_the_same_to_the_bit_with_any_number_of_workers(tmp_path: Path, sampler: str) -> None:
    alone = run(tmp_path / "one", sampler=sampler)
    for workers in (2, 3):
        together = run(tmp_path / f"many{workers}", sampler=sampler, workers=workers)
        assert together.trials == alone.trials
        assert together.plain() == alone.plain()


@pytest.mark.slow
@pytest.mark.process
def test_calibrate__continues_to_the_bit_after_a_kill(tmp_path: Path) -> None:
    whole = run(tmp_path / "whole")
    context = multiprocessing.get_context("spawn")
    for left in (9, 23):
        child = context.Process(target=run, args=(tmp_path / "parts", LinearModel(left, kill=True)))
        child.start()
        child.join(120)
        assert child.exitcode == -9
    assert run(tmp_path / "parts").plain() == whole.plain()


def test_calibrate__refuses_a_folder_with_other_settings(tmp_path: Path) -> None:
    run(tmp_path / "out", trials=1, batch=1, sampler="tpe")
    with pytest.raises(InvalidConfig, match=r"has a calibration with other settings \(seed\)"):
        run(tmp_path / "out", trials=1, batch=1, sampler="tpe", seed=1)


# Parameters files


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"timestamps": None}, "timestamps"),
        ({"periods": [["2017-01-09", "2017-01-08"]]}, "2017-01-08 is before 2017-01-09"),
        ({"held_out": [["2017-01-11", "2017-01-12"]]}, "overlaps the period that ends on 2017-01-11"),
        ({"parameters": {"a": {"edit": "people", "low": 1.0, "high": 1.0}}}, "nothing to calibrate"),
        ({"pruner": {"kind": "halving"}}, "use median or false"),
        ({"storage": "sqlite:///x.db"}, "keeps its trials in its folder"),
        ({"trial": 3}, "there is no such field; did you mean 'trials'"),
        ({"trials": None}, "trials: it is missing"),
    ],
)
def test_read_calibration__errors_name_the_field(tmp_path: Path, changes: dict[str, Any], error: str) -> None:
    with pytest.raises(InvalidConfig) as caught:
        configuration(tmp_path, **changes)
    assert error in str(caught.value)
