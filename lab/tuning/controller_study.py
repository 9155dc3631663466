"""Tuning files of controllers."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from zenostat.agent_sdk.controllers import ControllerProtocol, load_controller
from zenostat.agent_sdk.controllers.parameters import check_parameters
from zenostat.agent_sdk.envs.arguments import check_agent_fields, of_scenario
from zenostat.lab.config_file import FIELDS, FIELDS_OR_FALSE, No, Seed
from zenostat.lab.scenario_env import pop_env_id
from zenostat.lab.tuning.study_config import Pruner, StudyConfig
from zenostat.topics.errors import InvalidConfig


class ControllerStudy(StudyConfig):
    """A study of a controller: the fields of a tuning file with `controller`.

    The value of a trial is the mean of the metric over an episode for each seed and weather. The first trial has the
    controller's defaults, with the `fixed` parameters, so the best one is never worse than these.

    Attributes:
        controller: short name of a bundled one, or `path/to/file.py:Class`.
        scenario: id, or path of a scenario file.
        arguments: further arguments of `gym.make`, which override the scenario's settings.
        weathers: weather files, each of which has an episode for each seed; by default that of the scenario.
        seeds: seeds of the episodes.
        fixed: parameters of the controller that are not searched.
        pruner: by default the median of the other trials, after an episode of each weather; none with `cma-es`, which
            learns from finished trials only.
    """

    trial_module: ClassVar[str] = "zenostat.lab.tuning.controller_trial"
    keeps_processes: ClassVar[bool] = True
    begins_with_default: ClassVar[bool] = True

    controller: str
    scenario: str
    arguments: dict[str, Any] = Field(default_factory=dict)
    weathers: tuple[str, ...] = ()
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)] = (0,)
    fixed: dict[str, Any] = Field(default_factory=dict)
    pruner: Annotated[Annotated[Pruner, FIELDS] | No, FIELDS_OR_FALSE] = Pruner()

    @property
    def environment(self) -> dict[str, Any]:
        """Arguments of `gym.make`."""
        return {**of_scenario(self.scenario), **self.arguments}

    @property
    def episodes(self) -> int:
        """Number of episodes of a trial."""
        return len(self.seeds) * max(len(self.weathers), 1)

    def checked(self, what: str) -> Any:
        """Return the study with its number of trials and its pruner; see `StudyConfig.checked`."""
        config = super().checked(what)
        if "pruner" in self.model_fields_set:
            return config
        pruner = False if self.sampler == "cma-es" else Pruner(warmup_steps=max(len(self.weathers), 1))
        return config.model_copy(update={"pruner": pruner})

    def file_names(self) -> Iterable[Any]:
        """Return what may name the files of scenario, controller, model and weather."""
        module = self.controller.rpartition(":")[0]
        return (self.scenario, self.controller, module, *self.weathers, *self.arguments.values())

    def check(self) -> None:
        """Check scenario, controller and the names of its parameters."""
        pop_env_id(self.environment)
        check_agent_fields(self.scenario)
        check_names(load_controller(self.controller), self.parameters, self.fixed)

    def trial_fields(self, values: Mapping[str, Any], folder: Path) -> dict[str, Any]:  # noqa: ARG002
        """Return the controller of a trial and its episodes."""
        return {
            "controller": self.controller,
            "parameters": {**self.fixed, **values},
            "environment": {"arguments": self.environment, "weathers": self.weathers, "seeds": self.seeds},
        }

    def best_fields(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields of a controller file."""
        return {"controller": self.controller, "parameters": {**self.fixed, **values}}


def check_names(
    factory: Callable[..., ControllerProtocol], searched: Mapping[str, Any], fixed: Mapping[str, Any]
) -> None:
    """Check that a controller has the parameters that are searched or fixed.

    Raises:
        InvalidConfig: an unknown parameter, or one that is both searched and fixed.
    """
    for name in searched:
        if name in fixed:
            raise InvalidConfig(f"{name} is both searched and fixed; remove one of both")
    check_parameters(factory, [*searched, *fixed])
    missing = [
        name
        for name, parameter in list(inspect.signature(factory).parameters.items())[1:]
        if parameter.kind is parameter.KEYWORD_ONLY and parameter.default is parameter.empty and name not in fixed
    ]
    if missing:
        raise InvalidConfig(f"{missing[0]} has no default, with which a study begins: set it in fixed=")
