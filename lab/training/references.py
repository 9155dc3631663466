"""Mean rewards of other controllers in the evaluation episodes of a training, for comparison."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

from zenostat.agent_sdk.controllers import CONTROLLERS
from zenostat.agent_sdk.controllers.policy import preserve_random_state
from zenostat.agent_sdk.controllers.training_folder import REFERENCES
from zenostat.lab.evaluate import Evaluation, evaluate
from zenostat.lab.training.config import TrainingConfig
from zenostat.lab.training.curve import CurveFile
from zenostat.lab.training.environments import is_building
from zenostat.topics.errors import UnknownName, UsageError, did_you_mean

OnReferences = Callable[[dict[str, float]], None]
"""Called with the mean reward of an episode by reference."""


def check_references(config: TrainingConfig) -> None:
    """Check that the references of a training are bundled controllers.

    Raises:
        UnknownName: one of them is none.
    """
    for name in config.evaluation.references if config.evaluation else ():
        if name not in CONTROLLERS:
            raise UnknownName(
                f"evaluation.references: there is no bundled controller {name!r}; {did_you_mean(name, CONTROLLERS)}"
            )


def evaluate_references(config: TrainingConfig, folder: Path) -> None:
    """Run the references through the evaluation episodes, and write their metrics to `references.csv`.

    A reference that does not fit the scenario is left out with a warning.
    """
    settings = config.evaluation
    if not settings or not settings.references:
        return
    arguments = config.environment(for_evaluation=True)
    if not is_building(arguments):  # nothing else has other controllers
        return
    try:
        with preserve_random_state():
            result = evaluate(
                arguments, settings.references, episodes=settings.episodes, seed=settings.seed, wrappers=config.wrappers
            )
    except UsageError as error:
        warnings.warn(f"evaluation.references: {error}", stacklevel=2)
        return
    for name, reason in (result.unfit | result.failures).items():
        warnings.warn(f"evaluation.references: {name}: {reason}", stacklevel=2)
    _write(result, folder / REFERENCES)


def _write(result: Evaluation, path: Path) -> None:
    file = CurveFile(path)
    for row in result.table():
        file.add(row)
    file.close()
