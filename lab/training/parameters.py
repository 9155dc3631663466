"""Parameters of stable-baselines3's algorithms as data, checked before anything starts."""

from __future__ import annotations

import inspect
import math
import typing
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from pydantic import ConfigDict, TypeAdapter, ValidationError
from stable_baselines3 import DQN
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from zenostat.agent_sdk.controllers.policy import ALGORITHMS, preserve_random_state
from zenostat.lab.training.config import TrainingConfig
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownName, did_you_mean

_OWN_FIELDS = {
    "policy": "the field `policy`",
    "env": "the field `scenario`",
    "seed": "the field `seed`",
    "device": "the field `device`",
    "tensorboard_log": "`log: [tensorboard]`",
    "verbose": "the progress bar",
    "monitor_wrapper": "nothing: episodes are always recorded",
}
"""Arguments of the algorithms that are not parameters here, and what to use instead."""
_CODE = ("replay_buffer_class", "replay_buffer_kwargs", "rollout_buffer_class", "rollout_buffer_kwargs")
_NOISES = {"normal": NormalActionNoise, "ornstein-uhlenbeck": OrnsteinUhlenbeckActionNoise}
_ACTIVATIONS = {"elu": "ELU", "gelu": "GELU", "leaky_relu": "LeakyReLU", "relu": "ReLU", "silu": "SiLU", "tanh": "Tanh"}
_OPTIMIZERS = ("Adam", "AdamW", "RMSprop", "SGD")
LOG_STD_INIT = -1.5
"""Initial exploration of on-policy algorithms with actions from -1 to 1: a standard deviation of 0.22.

The default of stable-baselines3 is 1, half of the range: 3.75 K of a setpoint from 15 to 22.5 degC.
"""
_FRACTIONS = (
    "exploration_final_eps", "exploration_fraction", "exploration_initial_eps", "gae_lambda", "gamma",
    "tau",
)  # fmt: skip
_POSITIVE = (
    "batch_size", "buffer_size", "learning_rate", "max_grad_norm", "n_epochs", "n_steps", "policy_delay",
    "stats_window_size", "target_kl", "target_update_interval", "train_freq",
)  # fmt: skip
_NOT_NEGATIVE = ("clip_range", "clip_range_vf", "learning_starts", "vf_coef")
_CONTINUOUS = ("ddpg", "sac", "td3")
_OF_SPACES = ("observation_space", "action_space", "lr_schedule")
"""Arguments of policies that algorithms supply."""


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """Return an algorithm by its name.

    Raises:
        UnknownName: there is no such algorithm; the text suggests similar names.
    """
    if name not in ALGORITHMS:
        raise UnknownName(f"algorithm: there is no {name!r}; {did_you_mean(name, ALGORITHMS, limit=len(ALGORITHMS))}")
    return ALGORITHMS[name]


def parameter_names(algorithm: type[BaseAlgorithm]) -> list[str]:
    """Return the names of an algorithm's parameters."""
    names = list(inspect.signature(algorithm.__init__).parameters)[1:]
    return [name for name in names if not name.startswith("_") and name not in (*_OWN_FIELDS, *_CODE)]


def check_algorithm(config: TrainingConfig) -> None:
    """Check algorithm, policy and parameters, also by constructing the algorithm on an empty environment.

    Raises:
        UnknownName: there is no such algorithm.
        InvalidConfig: the policy, or names or values of parameters; all errors are listed.
    """
    algorithm = algorithm_class(config.algorithm)
    errors = ErrorCollector()
    errors.collect(lambda: policy_name(config))
    errors.collect(lambda: _check_device(config.device))
    errors.collect(lambda: _check_names(algorithm, config))
    frequency = config.parameters.get("train_freq")
    if config.slots > 1 and isinstance(frequency, list) and "episode" in frequency:
        errors.errors.append(InvalidConfig("parameters.train_freq: episodes need `slots: 1`; count steps instead"))
    errors.raise_if_any()
    is_discrete = config.algorithm == "dqn"
    action: gym.Space[Any] = gym.spaces.Discrete(2) if is_discrete else gym.spaces.Box(-1, 1, (1,))
    with preserve_random_state(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the training itself repeats them
        make_model(config, DummyVecEnv([lambda: _EmptyEnv(action)] * config.slots))


def _check_device(device: str) -> None:
    """Raise `InvalidConfig` for a device that this machine does not have; stable-baselines3 would take the CPU."""
    kind = device.partition(":")[0]
    is_missing = (kind == "cuda" and not torch.cuda.is_available()) or (
        kind == "mps" and not torch.backends.mps.is_available()
    )
    if is_missing:
        raise InvalidConfig(f"device: PyTorch has no {kind} on this machine; use cpu, or auto for the best that it has")


def policy_name(config: TrainingConfig) -> str:
    """Return the policy of a training; by default `MlpPolicy`, or `MlpLstmPolicy` for recurrent algorithms.

    Raises:
        InvalidConfig: the algorithm does not have that policy.
    """
    policies = algorithm_class(config.algorithm).policy_aliases
    of_vectors = [policy for policy in policies if policy.startswith("Mlp")]
    name = config.policy or of_vectors[0]
    if name not in policies:
        raise InvalidConfig(f"policy: {config.algorithm} has no {name!r}; {did_you_mean(name, of_vectors)}")
    if name not in of_vectors:
        raise InvalidConfig(f"policy: {name} is not for observations that are vectors; use {' or '.join(of_vectors)}")
    return name


def make_model(config: TrainingConfig, env: Any) -> BaseAlgorithm:
    """Construct the algorithm of a training on a vector environment of stable-baselines3.

    Raises:
        InvalidConfig: the algorithm rejects a parameter, or has no policy for the spaces.
    """
    algorithm = algorithm_class(config.algorithm)
    arguments = _convert(algorithm, config.parameters, env.action_space)
    is_scaled = config.normalization and config.normalization.actions and isinstance(env.action_space, gym.spaces.Box)
    if is_scaled and issubclass(algorithm, OnPolicyAlgorithm) and not arguments.get("use_sde"):
        arguments["policy_kwargs"] = {"log_std_init": LOG_STD_INIT, **(arguments.get("policy_kwargs") or {})}
    try:
        return algorithm(policy_name(config), env, seed=config.seed, device=config.device, **arguments)
    except (ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, RuntimeError, TypeError,
            ValueError) as error:  # fmt: skip
        raise InvalidConfig(f"{config.algorithm}: {error}") from None


def check_action_space(config: TrainingConfig, space: gym.Space[Any], names: tuple[str, ...]) -> None:
    """Check that an algorithm can have the actions of an environment.

    Raises:
        InvalidConfig: it cannot; the text names the actions, and what to change.
    """
    is_box, is_one_choice = isinstance(space, gym.spaces.Box), isinstance(space, gym.spaces.Discrete)
    label = f"{config.scenario} has " + (f"{'continuous' if is_box else 'discrete'} actions ({', '.join(names)})")
    if is_box and not all(space.shape or (1,)):
        raise InvalidConfig(f"{config.scenario} has no actions: a training needs at least one actuator")
    others = "; ppo, a2c and recurrent-ppo accept both kinds"
    if config.algorithm == "dqn" and not is_one_choice:
        fields = "`arguments: {discrete: 5, control: building}`"
        raise InvalidConfig(f"dqn needs one discrete action, and {label}: set {fields}{others}")
    if config.algorithm in _CONTINUOUS and not is_box:
        raise InvalidConfig(f"{config.algorithm} needs continuous actions, and {label}: use dqn{others}")


def _check_names(algorithm: type[BaseAlgorithm], config: TrainingConfig) -> None:
    known, hints = parameter_names(algorithm), _hints(algorithm)
    errors = []
    for name, value in config.parameters.items():
        if name in _OWN_FIELDS:
            errors.append(f"parameters.{name} is not a parameter; use {_OWN_FIELDS[name]}")
        elif name in _CODE:
            errors.append(f"parameters.{name} is code and cannot be written in a file")
        elif name not in known:
            errors.append(f"parameters: {config.algorithm} has no {name!r}; {did_you_mean(name, known)}")
        elif name == "policy_kwargs" and isinstance(value, Mapping):
            errors += _check_policy_names(algorithm, config, value)
        elif _is_schedule(value) and "Callable" not in str(hints[name]):
            errors.append(f"parameters.{name}: a constant expected, got {value!r}")
        elif name not in ("action_noise", "policy_kwargs") and not _is_schedule(value):
            errors += _check_value(f"parameters.{name}", hints[name], value)
        errors += [f"parameters.{name}: finite numbers expected, got {value!r}"] if _has_other_numbers(value) else []
    if errors:
        raise InvalidConfig("\n".join(errors))


def _has_other_numbers(value: Any) -> bool:
    """Return whether a value is or contains NaN or an infinity."""
    if isinstance(value, Mapping):
        return any(map(_has_other_numbers, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_has_other_numbers, value))
    return isinstance(value, float) and not math.isfinite(value)


def _check_policy_names(
    algorithm: type[BaseAlgorithm], config: TrainingConfig, arguments: Mapping[str, Any]
) -> list[str]:
    """Return an error for each name that the policy does not have; `policy_name` reports an unknown policy."""
    if config.policy is not None and config.policy not in algorithm.policy_aliases:
        return []
    policy = algorithm.policy_aliases[policy_name(config)]
    known = [name for name in list(inspect.signature(policy.__init__).parameters)[1:] if name not in _OF_SPACES]
    errors = [
        f"parameters.policy_kwargs: {config.algorithm} has no {name!r}; {did_you_mean(name, known)}"
        for name in arguments
        if name not in known
    ]
    return errors + _check_layers(algorithm, arguments.get("net_arch"))


def _check_layers(algorithm: type[BaseAlgorithm], layers: Any) -> list[str]:
    """Return an error if `net_arch` is neither a list of sizes, nor one for each network of the algorithm."""
    if layers is None:
        return []
    networks = ("pi", "vf") if issubclass(algorithm, OnPolicyAlgorithm) else ("pi", "qf")
    lists = list(layers.values()) if isinstance(layers, Mapping) else [layers]
    are_named = not isinstance(layers, Mapping) or (set(layers) <= {*networks} and algorithm is not DQN)
    are_sizes = all(isinstance(each, list) and all(type(size) is int and size > 0 for size in each) for each in lists)
    if are_named and are_sizes:
        return []
    by_network = "" if algorithm is DQN else f", or {{{networks[0]}: [64, 64], {networks[1]}: [64, 64]}}"
    return [f"parameters.policy_kwargs.net_arch: sizes of layers such as [64, 64]{by_network} expected, got {layers!r}"]


def _hints(algorithm: type[BaseAlgorithm]) -> dict[str, Any]:
    return typing.get_type_hints(algorithm.__init__, localns={"VecEnv": VecEnv})


def _check_value(where: str, hint: Any, value: Any) -> list[str]:
    """Return an error if a value has not the type of its parameter."""
    value = tuple(value) if isinstance(value, list) else value
    try:
        TypeAdapter(hint, config=ConfigDict(arbitrary_types_allowed=True, strict=True)).validate_python(value)
    except ValidationError:
        expected = str(hint).replace("typing.", "").replace("collections.abc.Callable[[float], float]", "schedule")
        expected = expected.removeprefix("<class '").removesuffix("'>")
        return [f"{where}: {expected} expected, got {value!r}"]
    name = where.removeprefix("parameters.")
    if isinstance(value, int | float) and not isinstance(value, bool):
        if name in _FRACTIONS and not 0 <= value <= 1:
            return [f"{where}: a number from 0 to 1 expected, got {value}"]
        if name in _POSITIVE and not value > 0:
            return [f"{where}: a number above 0 expected, got {value}"]
        if name in _NOT_NEGATIVE and value < 0:
            return [f"{where}: a number of at least 0 expected, got {value}"]
    return []


def _is_schedule(value: Any) -> bool:
    return isinstance(value, Mapping) and set(value) == {"linear"}


def _convert(algorithm: type[BaseAlgorithm], parameters: Mapping[str, Any], actions: gym.Space[Any]) -> dict[str, Any]:
    converted: dict[str, Any] = {}
    for name, value in parameters.items():
        if _is_schedule(value):
            converted[name] = _linear(name, value["linear"])
        elif name == "action_noise" and value is not None:
            converted[name] = _noise(value, actions)
        elif name == "policy_kwargs" and value is not None:
            converted[name] = _policy_arguments(value)
        else:
            converted[name] = tuple(value) if isinstance(value, list) else value
    if issubclass(algorithm, OffPolicyAlgorithm) and not isinstance(actions, gym.spaces.Box):
        converted.pop("action_noise", None)
    return converted


def _linear(name: str, value: Any) -> LinearSchedule:
    """Return a schedule from the first to the second value, or to 0, over the whole training."""
    ends = value if isinstance(value, list) else [value, 0.0]
    if len(ends) != 2 or not all(isinstance(end, int | float) and not isinstance(end, bool) for end in ends):
        raise InvalidConfig(f"parameters.{name}.linear: a number, or [first, last] expected, got {value!r}")
    return LinearSchedule(float(ends[0]), float(ends[1]), 1.0)


def _noise(value: Any, actions: gym.Space[Any]) -> ActionNoise:
    """Return noise on actions between -1 and 1, as the algorithms have them: `{kind: normal, sigma: 0.1}`."""
    kind = value.get("kind") if isinstance(value, Mapping) else None
    if not isinstance(value, Mapping) or not isinstance(kind, str) or kind not in _NOISES:
        kinds = " or ".join(_NOISES)
        raise InvalidConfig(f"parameters.action_noise: {{kind: {kinds}, sigma: 0.1}} expected, got {value!r}")
    size = int(np.prod(actions.shape or (1,)))
    noise, arguments = _NOISES[kind], {name: number for name, number in value.items() if name != "kind"}
    try:
        mean, deviation = np.full(size, float(arguments.pop("mean", 0.0))), np.full(size, float(arguments.pop("sigma")))
        if deviation[0] < 0.0:
            raise ValueError("sigma is negative")
        action_noise: ActionNoise = noise(mean, deviation, **arguments)
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidConfig(f"parameters.action_noise: {error} in {dict(value)!r}; sigma is required") from None
    return action_noise


def _policy_arguments(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise InvalidConfig(f"parameters.policy_kwargs: a mapping expected, got {value!r}")
    arguments = dict(value)
    if isinstance(name := arguments.get("activation_fn"), str):
        arguments["activation_fn"] = _named("activation_fn", name, _ACTIVATIONS, lambda n: getattr(torch.nn, n))
    if isinstance(name := arguments.get("optimizer_class"), str):
        optimizers = {optimizer: optimizer for optimizer in _OPTIMIZERS}
        arguments["optimizer_class"] = _named("optimizer_class", name, optimizers, lambda n: getattr(torch.optim, n))
    return arguments


def _named(field: str, name: str, known: Mapping[str, str], load: Callable[[str], Any]) -> Any:
    if name not in known:
        raise InvalidConfig(f"parameters.policy_kwargs.{field}: there is no {name!r}; {did_you_mean(name, known)}")
    return load(known[name])


class _EmptyEnv(gym.Env[Any, Any]):
    """An environment on which algorithms are constructed to check their parameters."""

    def __init__(self, actions: gym.Space[Any]) -> None:
        self.observation_space, self.action_space = gym.spaces.Box(-1, 1, (1,)), actions

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Return an observation."""
        super().reset(seed=seed, options=options)
        return self.observation_space.sample(), {}
