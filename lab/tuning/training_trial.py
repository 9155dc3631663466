"""The process of one trial: train with the parameters of the trial, and report its evaluations to the study."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from zenostat.lab.tuning.trial import Pruned, mean_metric, pruned_result, report_of, run_request
from zenostat.topics.errors import InvalidConfig


def main(folder: Path, parent: int) -> None:
    """Run the trial that is described in a folder.

    Args:
        folder: folder of the trial, with `trial.json`.
        parent: id of the process that started this one, and with which it ends.
    """
    from zenostat.bridge.engine.system_calls import die_with_parent

    die_with_parent(parent)
    run_request(folder, _run)


def _run(request: dict[str, Any]) -> dict[str, Any]:
    from zenostat.lab.training.config import read_training
    from zenostat.lab.training.run import train

    report = report_of(request)
    try:
        train(
            read_training(request["training"]),
            on_evaluation=lambda step, results: report.add(mean_metric(results, request["metric"]), step),
        )
    except Pruned:
        return pruned_result(report)
    if not report.values:
        raise InvalidConfig(
            "the training ended before its first evaluation: set evaluation.every_steps to at most steps"
        )
    return {"state": "complete", "value": report.values[-1]}


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else os.getppid())
