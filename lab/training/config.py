"""Training files: algorithm and its parameters, scenario, wrappers, normalization, evaluation, logs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from zenostat.agent_sdk.envs.arguments import of_scenario
from zenostat.lab.config_file import FIELDS, FIELDS_OR_FALSE, ConfigPart, Count, No, Number, Seed, read_file
from zenostat.topics.codec import validated
from zenostat.topics.keys import safe_name
from zenostat.topics.seed_validation import MAX_SEED

TrainingSeed = Annotated[int, Field(strict=True, ge=0, lt=2**32)]
"""NumPy's global generator, which stable-baselines3 seeds, accepts 32 bits."""
EVALUATIONS = 10
"""Evaluations, and checkpoints, of a training whose file gives no interval."""


class Normalization(ConfigPart):
    """Settings of `VecNormalize` and `RescaleAction`.

    Attributes:
        observations: to mean 0 and variance 1, by running statistics.
        rewards: to variance 1 of the discounted return.
        actions: to -1 to 1, if they are continuous.
        clip_observations, clip_rewards: bounds of the scaled values.
    """

    observations: bool = True
    rewards: bool = True
    actions: bool = True
    clip_observations: Number = 10.0
    clip_rewards: Number = 10.0


class Evaluation(ConfigPart):
    """Evaluations during the training, in an environment of their own.

    Attributes:
        every_steps, every_episodes: the interval in training steps, or in finished training episodes, over all slots;
            without both, a tenth of the training's steps.
        at_start: also evaluate before the first training step.
        episodes: number of episodes of an evaluation.
        seed: seed of the first one; episode k has `seed + k`, the same in each evaluation.
        scenario, arguments: override those of the training, for instance with another weather.
        references: bundled controllers that run through the same episodes once, before the training begins.
    """

    every_steps: Count | None = None
    every_episodes: Count | None = None
    at_start: bool = False
    episodes: Count = 1
    seed: Seed = 10_000
    scenario: str | None = None
    arguments: dict[str, Any] = Field(default_factory=dict)
    references: tuple[str, ...] = ("baseline",)

    @model_validator(mode="after")
    def _one_interval(self) -> Evaluation:
        if self.every_steps is not None and self.every_episodes is not None:
            raise ValueError("every_steps and every_episodes exclude each other; remove one of them")
        if self.seed + self.episodes - 1 > MAX_SEED:
            raise ValueError(f"the last of {self.episodes} episodes from seed {self.seed} on has one above 2**64 - 1")
        return self


class TrainingConfig(ConfigPart):
    """A training: the fields of a training file.

    Attributes:
        algorithm: a key of `zenostat.training.ALGORITHMS`.
        scenario: id, or path of a scenario file.
        arguments: further arguments of `gym.make`, which override the scenario's settings.
        wrappers: applied after the scenario's own; see `zenostat.wrappers.apply_wrappers`.
        steps: training steps over all slots; a rollout that has begun is completed.
        seed: seed of the algorithm and of the first episode; slot i has `seed + i`.
        slots: number of buildings that are simulated side by side.
        policy: name of the algorithm's policy; by default for vectors.
        parameters: keyword arguments of the algorithm.
        paired_reward: whether rewards are differences to those of zero actions in the same weather; see
            `zenostat.lab.training.paired_reward`.
        zero_start: whether the policy begins with offsets of zero; see `zenostat.lab.training.zero_actions`.
        normalization: false: nothing is scaled.
        evaluation: false: none.
        checkpoint_steps: training steps between checkpoints; by default a tenth of all.
        log: further logs, beside the CSV files.
        wandb: arguments of `wandb.init`.
        output: folder of the results.
        device: device of torch.
        threads: number of threads of torch; by default its own choice.
    """

    algorithm: str
    scenario: str
    arguments: dict[str, Any] = Field(default_factory=dict)
    wrappers: tuple[dict[str, Any], ...] = ()
    steps: Count
    seed: TrainingSeed = 0
    slots: Annotated[int, Field(strict=True, ge=1, le=256)] = 1
    policy: str | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)
    paired_reward: bool = False
    zero_start: bool = False
    normalization: Annotated[Annotated[Normalization, FIELDS] | No, FIELDS_OR_FALSE] = Normalization()
    evaluation: Annotated[Annotated[Evaluation, FIELDS] | No, FIELDS_OR_FALSE] = Evaluation()
    checkpoint_steps: Count | None = None
    log: tuple[Literal["tensorboard", "wandb"], ...] = ()
    wandb: dict[str, Any] = Field(default_factory=dict)
    output: str | None = None
    device: str = "cpu"
    threads: Annotated[int, Field(strict=True, ge=1, le=1024)] | None = None

    @property
    def folder(self) -> Path:
        """Folder of the results; by default named after scenario, algorithm and seed."""
        scenario = re.sub(r"\.ya?ml$", "", Path(self.scenario).name)  # an id may have dots, those of its weather
        name = f"{safe_name(scenario)}-{safe_name(self.algorithm)}-{self.seed}"
        return Path("training") / name if self.output is None else Path(self.output)

    @property
    def evaluation_steps(self) -> int | None:
        """Training steps between evaluations; None if they are counted in episodes, or there are none."""
        if not self.evaluation or self.evaluation.every_episodes is not None:
            return None
        return self.evaluation.every_steps or max(self.steps // EVALUATIONS, 1)

    def environment(self, *, for_evaluation: bool = False) -> dict[str, Any]:
        """Return the arguments of `gym.make` for the training, or for its evaluations."""
        scenario, arguments = self.scenario, self.arguments
        if for_evaluation and self.evaluation:
            scenario = self.evaluation.scenario or scenario
            arguments = {**arguments, **self.evaluation.arguments}
        return {**of_scenario(scenario), **arguments}

    def plain(self) -> dict[str, Any]:
        """Return the fields as built-in types, those with default values included."""
        return self.model_dump(mode="json")


def read_training(fields: Mapping[str, Any], what: str = "the training") -> TrainingConfig:
    """Validate the fields of a training file.

    Raises:
        InvalidConfig: lists all errors of form. Names and values of the algorithm's parameters are checked by
            `zenostat.lab.training.parameters.check_algorithm`.
    """
    return validated(TrainingConfig, fields, what)


def load_training(path: str | Path) -> TrainingConfig:
    """Read a training file; errors as of `read_file` and `read_training`."""
    return read_training(read_file(path), str(path))
