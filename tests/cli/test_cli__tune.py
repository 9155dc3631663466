"""`zenostat tune` without a terminal: a line per trial, with the reason of each that failed or was pruned."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.csv_files import csv_rows
from support.run_cli import output_of

from zenostat.topics import yaml12

optuna = pytest.importorskip("optuna")

from zenostat.cli.tune import _line  # noqa: E402
from zenostat.lab.tuning.study import reason_of  # noqa: E402

CONTROLLER = """
from zenostat.agent_sdk.controllers import RuleBasedController

class Picky(RuleBasedController):
    def __init__(self, manifest, margin=0.0, setback=0.0):
        if margin == 1.0:
            raise ValueError("no such margin\\nit is between 0 and 0.9")
        super().__init__(manifest, margin=margin, setback=setback)
"""


def test_tune__trial_of_a_lost_machine_has_a_reason() -> None:
    lost = optuna.trial.create_trial(state=optuna.trial.TrialState.FAIL)
    assert reason_of(lost) == "the machine that ran it was lost"
    assert _line(lost) == "trial -1: fail the machine that ran it was lost (default)"
    assert reason_of(optuna.trial.create_trial(value=1.0)) == ""


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
def test_tune__shows_a_line_for_each_trial_without_a_terminal(tmp_path: Path) -> None:
    (tmp_path / "picky.py").write_text(CONTROLLER)
    fields = {
        "study": "margins",
        "controller": "picky.py:Picky",
        "scenario": "Fake-v1",
        "arguments": {"zones": 1, "end": "07-03", "steps_per_hour": 2, "control": "building"},
        "parameters": {"margin": {"choices": [0.0, 1.0]}, "setback": {"choices": [0.0, 6.0]}},
        "sampler": "grid",
        "pruner": {"kind": "median", "startup_trials": 1, "warmup_steps": 0},
        "seeds": [0, 1],
        "output": "out",
    }
    (tmp_path / "tune.yaml").write_text(yaml12.dump(fields))
    lines = output_of("tune", "tune.yaml", cwd=tmp_path).splitlines()
    assert lines[0] == "margins: 0 of 5 trials have ended"
    trials = lines[1:6]  # that of the defaults, and the grid
    for number, line in enumerate(trials, 1):
        assert line.startswith(f"[{number}/5] trial {number - 1}: "), line
    failed = [line for line in trials if "margin 1" in line]
    assert len(failed) == 2
    assert "margins: 2 complete, 1 pruned, 2 fail" in lines
    for line in failed:
        assert re.search(r"fail its process ended with 1: ValueError: no such margin; see \S+/log\.txt \(", line), line
    worse = next(line for line in trials if "margin 0, setback 6" in line)  # than the one before
    assert "worse than the median of the trials before at step 1 (" in worse
    rows = csv_rows(tmp_path / "out" / "trials.csv")
    assert [bool(row["reason"]) for row in rows] == [row["state"] != "COMPLETE" for row in rows]
    again = output_of("tune", "tune.yaml", cwd=tmp_path).splitlines()
    assert again[0] == "margins: 5 of 5 trials have ended"
