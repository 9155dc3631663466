"""Trainings that are interrupted and resumed."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.save_util import load_from_zip_file

from zenostat.lab.training import read_training, train


def model_content(path: Path) -> tuple[Any, Any]:
    """Return weights and optimizers of a model's file."""
    _, parameters, variables = load_from_zip_file(path)
    return parameters, variables


def same(one: Any, other: Any) -> bool:
    """Return whether two nested contents of models are equal to the bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if torch.is_tensor(one):
        return torch.equal(one, other)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def check_resumed(fields: Callable[[Path], dict[str, Any]], folder: Path) -> None:
    """Stop a training within an episode and resume it; compare it with one that was not interrupted.

    Args:
        fields: Returns the fields of the training with an output folder.
        folder: The folder of both outputs, `whole` and `cut`.
    """
    whole = train(read_training(fields(folder / "whole")))
    stop = threading.Event()
    cut = train(
        read_training(fields(folder / "cut")),
        progress=lambda status: stop.set() if status.step >= 101 else None,
        stop=stop,
    )
    assert not cut.finished
    assert 0 < cut.step < whole.step
    torch.rand(7), np.random.random(5)  # a new process has other random states
    again = train(read_training(fields(folder / "cut")), resume=True)
    assert again.finished
    assert same(model_content(whole.folder / "model.zip"), model_content(again.folder / "model.zip"))
    for file in ("curve.csv", "evaluations.csv"):
        if (whole.folder / file).exists():
            assert (whole.folder / file).read_text() == (again.folder / file).read_text()
