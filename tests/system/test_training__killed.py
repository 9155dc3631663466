"""A training in real processes that is killed or stopped leaves nothing, and continues to the bit in a new process."""

import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from support.nodes import SMALL, nothing_left, until
from support.run_cli import ZENOSTAT, run_program

from zenostat.topics import yaml12

pytest.importorskip("stable_baselines3")
pytest.importorskip("torch")

from stable_baselines3.common.save_util import load_from_zip_file

TRAINING: dict[str, Any] = {
    "algorithm": "a2c", "scenario": f"{SMALL['building']}-{SMALL['weather']}-continuous-stochastic-v1", "seed": 1,
    "arguments": {"steps_per_hour": 4, "begin": "07-03", "end": "07-03"}, "slots": 2, "steps": 500, "threads": 1,
    "parameters": {"n_steps": 10, "policy_kwargs": {"net_arch": [8]}}, "checkpoint_steps": 100,
    "evaluation": {"every_steps": 250}, "output": "whole",
}  # fmt: skip


def content(folder: Path) -> tuple[dict[str, bytes], list[str]]:
    """Weights of the last model, and the learning curve."""
    _, parameters, _ = load_from_zip_file(folder / "model.zip")
    weights = {name: value.numpy().tobytes() for name, value in parameters["policy"].items()}
    return weights, [(folder / name).read_text() for name in ("curve.csv", "evaluations.csv")]


def _wait_for_rows(path: Path) -> None:
    """Wait for a table with a row; two nodes start before, which takes over a minute on a busy machine."""
    for patience in range(3, 0, -1):
        try:
            until(lambda: path.exists() and path.read_text().count("\n") > 1, "the first evaluation")
            return
        except AssertionError:
            if patience == 1:
                raise


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_training__interrupted_training_continues_to_the_bit(number: signal.Signals, scratch: Path) -> None:
    (scratch / "t.yaml").write_text(yaml12.dump(TRAINING))
    with nothing_left(scratch):
        command = [*ZENOSTAT, "train", "t.yaml", "--output", "cut"]
        process = subprocess.Popen(command, cwd=scratch, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            # The evaluation's node runs as well, and the second episodes have begun.
            _wait_for_rows(scratch / "cut" / "evaluations.csv")
            process.send_signal(number)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == (-number if number == signal.SIGKILL else 128 + number), err
    assert "Traceback" not in err
    if number == signal.SIGINT:
        assert "continue with: zenostat train cut --resume" in out
    assert not (scratch / "cut" / "model.zip").exists()
    for command in (["cut", "--resume"], ["t.yaml"]):
        done = run_program("train", *command, cwd=scratch)
        assert done.returncode == 0, done.stderr
    assert content(scratch / "cut") == content(scratch / "whole")
