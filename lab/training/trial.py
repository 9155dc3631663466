"""The process of one trial: train with the parameters of the trial, and report its evaluations to the study."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import UsageError, ZenostatError

REQUEST, RESULT = "trial.json", "result.json"


def main(folder: Path, parent: int) -> None:
    """Run the trial that is described in a folder, and write its result there; without a result it has failed.

    Args:
        folder: folder of the trial, with `trial.json`.
        parent: id of the process that started this one, and with which it ends.
    """
    from zenostat.bridge.engine.system_calls import die_with_parent

    die_with_parent(parent)
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    try:
        result = _run(request)
    except ZenostatError as error:
        result = {"state": "fail", "reason": str(error), "invalid": isinstance(error, UsageError)}
    with atomic_file(folder / RESULT) as temporary:
        temporary.write_text(json.dumps(result), encoding="utf-8")


def _run(request: dict[str, Any]) -> dict[str, Any]:
    import numpy as np
    import optuna

    from zenostat.lab.training.config import read_training
    from zenostat.lab.training.run import train
    from zenostat.lab.training.study_storage import database_errors, make_pruner, open_storage
    from zenostat.lab.training.tuning_config import Pruner
    from zenostat.topics.errors import InvalidConfig, did_you_mean

    settings = request["pruner"] and Pruner.model_validate(request["pruner"])
    with database_errors(request["url"]):
        storage = open_storage(request["url"])
        study = optuna.load_study(study_name=request["study"], storage=storage, pruner=make_pruner(settings))
        trial = optuna.trial.Trial(study, request["trial_id"])
    metric, values = request["metric"], []

    def report(step: int, results: Any) -> None:
        episodes = [result.metrics().get(metric) for result in results]
        if None in episodes:
            names = [name for name, value in results[0].metrics().items() if value is not None]
            raise InvalidConfig(f"metric: the evaluations have no {metric!r}; {did_you_mean(metric, names)}")
        values.append(float(np.mean(np.array(episodes, np.float64))))
        with database_errors(request["url"]):
            trial.report(values[-1], step)
            if trial.should_prune():
                raise _Pruned

    try:
        train(read_training(request["training"]), on_evaluation=report)
    except _Pruned:
        return {"state": "pruned", "value": values[-1]}
    if not values:
        raise InvalidConfig("the training ended before its first evaluation: set evaluation.every_steps below steps")
    return {"state": "complete", "value": values[-1]}


class _Pruned(Exception):
    """The pruner ends the trial."""


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else os.getppid())
