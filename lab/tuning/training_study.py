"""Tuning files of trainings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from zenostat.lab.config_file import with_field
from zenostat.lab.training.config import TrainingConfig, read_training
from zenostat.lab.tuning.study_config import StudyConfig
from zenostat.topics.errors import InvalidConfig


class TrainingStudy(StudyConfig):
    """A study of trainings: the fields of a tuning file with `training`.

    Its parameters are fields of the training: `parameters.learning_rate`, `slots`, `wrappers`.

    Attributes:
        training: path of a training file, or its fields. The value of a trial is the mean of its last evaluation.
    """

    trial_module: ClassVar[str] = "zenostat.lab.tuning.training_trial"
    keeps_processes: ClassVar[bool] = False
    begins_with_default: ClassVar[bool] = False

    training: dict[str, Any] | str

    def training_of(self, values: Mapping[str, Any], output: Path) -> TrainingConfig:
        """Return the training of a trial with these values of the searched parameters."""
        config = self._whole_training_of(values, output)
        if not config.evaluation:
            return config
        alone = config.evaluation.model_copy(update={"references": ()})  # the same in each trial
        return config.model_copy(update={"evaluation": alone})

    def _whole_training_of(self, values: Mapping[str, Any], output: Path) -> TrainingConfig:
        assert isinstance(self.training, dict)
        fields: dict[str, Any] = {**self.training, "output": str(output)}
        for path, value in values.items():
            fields = with_field(fields, path, value)
        return read_training(fields)

    def checked(self, what: str) -> Any:
        """Return the study with its number of trials; see `StudyConfig.checked`.

        Raises:
            InvalidConfig: the training with the first value of each searched parameter is invalid as well, or its
                first evaluation comes after its last step.
        """
        config = super().checked(what)
        training = config.training_of(config.first_values, config.folder)
        if not training.evaluation:
            raise InvalidConfig(f"{what}: training.evaluation: a study compares evaluations, so it cannot be false")
        is_searched = not {"steps", "evaluation.every_steps"}.isdisjoint(config.parameters)
        if (training.evaluation_steps or 0) > training.steps and not (training.evaluation.at_start or is_searched):
            raise InvalidConfig(
                f"{what}: training.evaluation.every_steps: {training.evaluation_steps} is above the {training.steps} "
                "steps, but a study compares evaluations"
            )
        return config

    def file_names(self) -> Iterable[Any]:
        """Return what may name the files of scenario, model and weather."""
        training = self.training_of(self.first_values, self.folder)
        return (training.scenario, *training.arguments.values())

    def check(self) -> None:
        """Check the parameters of the algorithm."""
        from zenostat.lab.training.parameters import check_algorithm

        check_algorithm(self.training_of(self.first_values, self.folder))

    def trial_fields(self, values: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        """Return the training of a trial."""
        return {"training": self.training_of(values, folder / "training").plain()}

    def best_fields(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields of a training file, its references included."""
        return self._whole_training_of(values, self.folder / "best").plain()
