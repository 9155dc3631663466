"""The process of trials of a controller, one after another, in an environment that stays open."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from zenostat.lab.tuning.controller_episodes import ControllerEpisodes
from zenostat.lab.tuning.trial import Pruned, pruned_result, report_of, run_request


class TrialRunner:
    """Runs trials, and keeps the environment from one to the next."""

    def __init__(self) -> None:
        self._episodes: ControllerEpisodes | None = None
        self._environment: dict[str, Any] = {}

    def run(self, request: dict[str, Any]) -> dict[str, Any]:
        """Run the trial that a request describes; return its result."""
        from zenostat.agent_sdk.controllers import load_controller

        report, factory = report_of(request), load_controller(request["controller"])
        try:
            episodes = self._open(request["environment"])
            value = episodes.value(factory, request["parameters"], request["metric"], report)
        except Pruned:
            return pruned_result(report)
        except BaseException:
            self.close()  # the next trial gets a new one
            raise
        return {"state": "complete", "value": value}

    def _open(self, environment: dict[str, Any]) -> ControllerEpisodes:
        if self._episodes is None or environment != self._environment:
            self.close()
            self._episodes, self._environment = ControllerEpisodes(**environment), environment
        return self._episodes

    def close(self) -> None:
        """Close the environment."""
        if self._episodes is not None:
            self._episodes.close()
        self._episodes = None


def main(parent: int) -> None:
    """Run the trials whose folders are the lines of standard input.

    Args:
        parent: id of the process that started this one, and with which it ends.
    """
    from zenostat.bridge.engine.system_calls import die_with_parent

    die_with_parent(parent)
    runner = TrialRunner()
    try:
        for line in sys.stdin:
            run_request(Path(line.rstrip("\n")), runner.run)
    finally:
        runner.close()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else os.getppid())
