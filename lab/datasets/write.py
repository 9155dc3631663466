"""Write data sets of controllers' episodes."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from zenostat.agent_sdk.controllers import Agent, ControllerProtocol, make_controller
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.wrappers.names import names_of, reject_wrappers
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.node_arguments import to_json
from zenostat.lab.datasets.episode import AgentEpisode, run_episode
from zenostat.lab.datasets.minari_writer import check_minari, check_new_dataset, datasets_folder, write_minari
from zenostat.lab.evaluate import (
    ControllerFactory,
    Progress,
    assign_parameters,
    controller_factories,
    is_baseline_factory,
)
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig

_NOT_ARGUMENTS = ("id", "about", "wrappers")
"""Fields of a scenario file that are not arguments of an environment."""


def write_dataset(
    env: gym.Env[Any, Any] | Callable[[], gym.Env[Any, Any]],
    controllers: Sequence[str] | Mapping[str, str | ControllerFactory],
    dataset_id: str,
    *,
    episodes: int = 1,
    seed: int = 0,
    epsilon: float = 0.0,
    parameters: Mapping[str, Any] | None = None,
    folder: str | Path | None = None,
    author: str | None = None,
    description: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Run controllers through episodes, and write them as one data set that `minari.load_dataset` reads.

    The same arguments and versions give the same bytes. The data set appears when it is complete, or not at all.

    Args:
        env: an environment of `gym.make("zenostat/...")`, within wrappers of observations and rewards if any, which
            stays open; or a function that makes it, called when the other arguments have been checked.
        controllers: as for `evaluate`; `baseline` sends no actions, and so has none to write.
        dataset_id: NAMESPACE/NAME-vNUMBER.
        episodes: episodes of each controller.
        seed: of the first episode; each further episode of the data set adds 1, so that no two have the same weather
            noise.
        epsilon: probability of a random action in place of the controller's, 0 to 1.
        parameters: parameters of the controllers; each gets those that it has.
        folder: folder of all data sets; None: as `datasets_folder`.
        author: for the metadata.
        description: for the metadata; None: one that names building and controllers.
        progress: callback for each timestep.

    Returns:
        The folder of the data set.

    Raises:
        InvalidConfig: an argument is invalid, the data set exists, or Minari is not installed.
        UsageError: a controller does not exist or does not fit the environment.

    Warns:
        UserWarning: an argument or a wrapper of the environment cannot be written as JSON.
    """
    check_minari()
    if not isinstance(episodes, int) or episodes < 1 or seed < 0 or not 0.0 <= epsilon <= 1.0:
        raise InvalidConfig(
            f"episodes={episodes}, seed={seed}, epsilon={epsilon}: expected at least one episode, a seed of at least "
            "0, and a probability of 0 to 1"
        )
    root = datasets_folder(folder)
    with _not_left_empty(root):
        path = check_new_dataset(dataset_id, root)
        factories = controller_factories(controllers)
        arguments = assign_parameters(factories, parameters or {}, seed)
        for name, factory in factories.items():
            if is_baseline_factory(factory):
                raise InvalidConfig(
                    f"the controller {name!r} sends no actions, so a data set of it would have none; `fixed` with the "
                    "building's own setpoints is a similar controller that does"
                )
        owned = None if isinstance(env, gym.Env) else env()
        environment: gym.Env[Any, Any] = owned if owned is not None else env  # type: ignore[assignment]
        try:
            _check_spaces(environment)
            reject_wrappers(environment, ["RewardVector"], "a data set has a number as reward; leave {} out")
            building = _building(environment)
            created = {name: make_controller(f, building.manifest, arguments[name]) for name, f in factories.items()}
            settings = {name: {"parameters": arguments[name], "episodes": episodes} for name in created}
            metadata = _metadata(building, dataset_id, settings, _names(environment), seed, epsilon)
            metadata |= {"author": {author}} if author else {}
            metadata |= {"description": description or _description(building, list(created), epsilon)}
            write_minari(
                path,
                root,
                spaces=(environment.observation_space, environment.action_space),
                spec=_spec(environment, building),
                metadata=metadata,
                episodes=_run(environment, created, episodes, seed, epsilon, progress),
            )
        finally:
            if owned is not None:
                owned.close()
        return path


def _check_spaces(env: gym.Env[Any, Any]) -> None:
    """Raise `InvalidConfig` if observations or actions are no arrays, before anything is simulated."""
    for what, space in (("observations", env.observation_space), ("actions", env.action_space)):
        if space.shape is None:
            raise InvalidConfig(
                f"a data set has {what} that are arrays, not of {type(space).__name__}: leave out the wrapper that "
                "makes them so, or flatten them (gymnasium.wrappers.FlattenObservation)"
            )


@contextmanager
def _not_left_empty(folder: Path) -> Iterator[None]:
    """Remove a folder that was created meanwhile and is empty."""
    existed = folder.exists()
    try:
        yield
    finally:
        if not existed:
            with suppress(OSError):  # it is not empty
                folder.rmdir()


def _run(
    env: gym.Env[Any, Any],
    controllers: Mapping[str, ControllerProtocol],
    episodes: int,
    seed: int,
    epsilon: float,
    progress: Progress | None,
) -> Iterator[tuple[AgentEpisode, dict[str, Any]]]:
    """Run all episodes, each with its metadata."""
    building: Any = env.unwrapped
    steps = building.manifest.steps
    for name, controller in controllers.items():
        agent = Agent(controller, building)
        for number in range(episodes):

            def report(step: int, name: str = name, number: int = number) -> None:
                if progress is not None:
                    progress(name, number, step, steps)

            episode = run_episode(env, agent, seed=seed, epsilon=epsilon, progress=report)
            rewards = episode.trajectory.rewards
            assert rewards is not None
            weather = episode.trajectory.weather
            yield episode, {"controller": name, "weather": weather, "return": float(rewards.sum())}
            seed += 1


def _building(env: gym.Env[Any, Any]) -> BuildingEnv:
    building = env.unwrapped
    if not isinstance(building, BuildingEnv):
        raise InvalidConfig(f"{type(building).__name__} is not a zenostat/ environment")
    if env.action_space != building.action_space:
        raise InvalidConfig(
            f"the wrappers around {building.manifest.building} change the actions from {building.action_space} to "
            f"{env.action_space}, in which controllers do not answer; leave these wrappers out"
        )
    return building


def _scenario(building: BuildingEnv) -> str:
    """Return the scenario as YAML; "" if the environment has no node."""
    return building.link.scenario() if isinstance(building.link, ControllerLink) else ""


def _spec(env: gym.Env[Any, Any], building: BuildingEnv) -> EnvSpec | None:
    """Return the specification from which Minari recovers the environment, without paths of this machine if possible.

    `gymnasium.make` does not repeat the wrappers of the scenario, which the environment has when it is created.
    """
    spec = env.spec
    if spec is None:
        return None
    own = {name: value for name, value in spec.kwargs.items() if callable(value)}  # a reward of the user's
    is_of_file = "file" in spec.kwargs or Path(spec.kwargs.get("scenario") or "").suffix in (".yaml", ".yml")
    if is_of_file and not building.manifest.task.wrappers:
        fields = yaml12.parse(_scenario(building), "the node's scenario")
        kwargs = {name: value for name, value in fields.items() if name not in _NOT_ARGUMENTS} | own
    else:
        kwargs = {name: to_json(value) for name, value in spec.kwargs.items()}
    wrappers = {wrapper.name: wrapper.kwargs for wrapper in spec.additional_wrappers}
    code = [name for name, value in (kwargs | wrappers).items() if not _is_json(value)]
    unrecorded = [name for name, value in wrappers.items() if value is None]
    if code or unrecorded:
        problems = [f"{name} is code or cannot be written as JSON" for name in code]
        problems += [
            f"{name} does not record its arguments (gymnasium.utils.RecordConstructorArgs)" for name in unrecorded
        ]
        warnings.warn(
            f"Minari will not recover the environment from the data set, so make it as here: {'; '.join(problems)}",
            stacklevel=3,
        )
        return None
    return replace(spec, kwargs=kwargs)


def _is_json(value: Any) -> bool:
    try:
        json.dumps(value)
    except (TypeError, ValueError):
        return False
    return True


def _metadata(
    building: BuildingEnv,
    dataset_id: str,
    controllers: Mapping[str, Any],
    observations: Sequence[str],
    seed: int,
    epsilon: float,
) -> dict[str, Any]:
    versions = building.manifest.versions
    algorithm = ", ".join(controllers) + (f", epsilon {epsilon:g}" if epsilon else "")
    return {
        "dataset_id": dataset_id,
        "algorithm_name": algorithm,
        "minari_version": version("minari"),
        "zenostat": {
            "controllers": json.loads(json.dumps(controllers, default=str)),
            "seed": seed,
            "epsilon": epsilon,
            "observations": list(observations),
            "actions": [action.name for action in building.manifest.task.actions],
            "scenario": _scenario(building),
            "versions": {"zenostat": versions.zenostat, "energyplus": versions.energyplus},
        },
    }


def _names(env: gym.Env[Any, Any]) -> tuple[str, ...]:
    """Return the names of the observation's values; none where a wrapper leaves them without names."""
    try:
        return names_of(env)
    except InvalidConfig:
        return ()


def _description(building: BuildingEnv, controllers: Sequence[str], epsilon: float) -> str:
    scenario = building.manifest.task.scenario or building.manifest.building
    mixed = f", with random actions in {100.0 * epsilon:.3g}% of the timesteps" if epsilon else ""
    return f"EnergyPlus building {scenario} controlled by {', '.join(controllers)}{mixed}."
