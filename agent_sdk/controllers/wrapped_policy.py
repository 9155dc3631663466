"""A model that was trained behind wrappers as a controller of a node."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any

import gymnasium as gym

from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.controllers.predictor import Predictor, describe_difference
from zenostat.agent_sdk.envs.action_values import named_values
from zenostat.agent_sdk.envs.arguments import FROM_SCENARIO
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards.reward_reader import CUSTOM
from zenostat.agent_sdk.wrappers.checkpoint import LOGS, frozen_statistics, set_wrapper_states, without_logs
from zenostat.agent_sdk.wrappers.serialization import apply_wrappers
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.arrays import Floats
from zenostat.topics.messages import Ack, EngineStart, EpisodeStart, Manifest, WeatherSeries


class WrappedPolicy(Controller):
    """A trained model within the wrappers of its training.

    The wrappers are those of Gymnasium's interface: they call `step`, which returns the next observation. A controller
    is called the other way round, with a sample. So the wrapped environment runs in a thread of its own, whose samples
    are those of the controller and whose commands the controller returns; one of both always waits for the other.

    Args:
        manifest: the node's manifest.
        model: a model of stable-baselines3, or any object with its `predict` and spaces.
        normalization: its `VecNormalize`, if it was trained behind one.
        wrappers: the wrappers of its training, innermost first.
        states: what they have learnt, from the outermost; see `zenostat.wrappers.save_wrappers`.

    Raises:
        ControllerMismatch: the node's observations or actions within the wrappers are not those of the training, or
            the model takes action masks, and the wrappers have none.
    """

    sets_context = True
    """Commands may name actuators of no action, which a `ChangingContext` of its wrappers sets."""

    def __init__(
        self,
        manifest: Manifest,
        model: Any,
        normalization: Any,
        wrappers: Sequence[Mapping[str, Any]],
        states: Sequence[Mapping[str, Any]],
    ) -> None:
        super().__init__(manifest)
        self._model, self._normalization = model, normalization
        # Beyond a limit on the timesteps of training, the node's episode continues, and the wrappers with it.
        needs_limit = any(wrapper["wrapper"] == "TimeAwareObservation" for wrapper in wrappers)
        left_out = LOGS if needs_limit else (*LOGS, "TimeLimit")
        self._wrappers = [wrapper for wrapper in wrappers if wrapper["wrapper"] not in left_out]
        self._states = without_logs(states)
        self._link: _SampleQueue | None = None
        self._seed: int | None = None
        self._episodes = 0
        with self._environment(_SampleQueue(manifest)) as env:  # before the states, which only fit these spaces
            for kind in ("observation", "action"):
                current, trained = getattr(env, f"{kind}_space"), getattr(model, f"{kind}_space")
                if current != trained:
                    raise ControllerMismatch(
                        f"the model was trained on other {kind}s than those of {manifest.node!r} within the wrappers "
                        f"of its training: {describe_difference(trained, current)}; use the scenario of its training"
                    )
            Predictor(model, env)
            self._restore(env)

    @contextmanager
    def _environment(self, link: _SampleQueue) -> Iterator[gym.Env[Any, Any]]:
        # A reward that is code of the program that evaluates is not among the data of the manifest.
        is_code = (link.manifest.task.reward or {}).get("kind") == CUSTOM
        with BuildingEnv(link=link, reward=None if is_code else FROM_SCENARIO) as env:
            wrapped = apply_wrappers(env, self._wrappers)
            with frozen_statistics(wrapped):
                yield wrapped

    def _restore(self, env: gym.Env[Any, Any]) -> None:
        """Give the wrappers what they have learnt in the training."""
        if self._states:
            set_wrapper_states(env, self._states, "the state of the training's wrappers")

    def seed_episode(self, seed: int) -> None:
        """Let the wrappers draw from the seed of the next episode, as in an evaluation of its training.

        Without it, each episode draws from its number, from 0 on.
        """
        self._seed = seed

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the wrappers and the state of a recurrent model."""
        if self._link is not None:
            self._link.cancel()
        self._link = _SampleQueue(self.manifest)
        torch = sys.modules.get("torch")  # loaded with a model of stable-baselines3
        seed = self._episodes if self._seed is None else self._seed
        arguments = (self._link, torch and torch.get_num_threads(), seed)
        self._seed = None
        self._episodes += 1
        threading.Thread(target=self._run, args=arguments, name="policy", daemon=True).start()

    def act(self, sample: SampleView) -> Values:
        """Return the model's action without exploration, as the wrappers convert it."""
        if self._link is None:
            self.begin(sample)
        assert self._link is not None
        return self._link.exchange(sample)

    def _run(self, link: _SampleQueue, torch_threads: int | None, seed: int) -> None:
        if torch_threads is not None:
            sys.modules["torch"].set_num_threads(torch_threads)  # it applies to the thread that calls it
        try:
            with self._environment(link) as env:
                self._restore(env)
                predictor, (observation, _) = Predictor(self._model, env), env.reset(seed=seed)
                while True:
                    if self._normalization is not None:
                        observation = self._normalization.normalize_obs(observation)
                    observation, *_ = env.step(predictor.action(observation))
        except _Canceled:
            pass
        except Exception as error:
            link.commands.put(error)


class _Canceled(Exception):
    """Another episode has begun."""


class _SampleQueue:
    """The link of an environment whose samples another thread supplies, and whose commands it gets."""

    name = "policy"

    def __init__(self, manifest: Manifest) -> None:
        # A limit would end the environment's episode while the node's continues. Of a branch, the first sample is the
        # environment's reset.
        task = manifest.task.model_copy(update={"terminate": ()})
        self.manifest = manifest.model_copy(update={"task": task, "branch_of": ""})
        start = EpisodeStart(engine_start=EngineStart.REUSED, weather=manifest.weather)
        self.accepted = Ack(episode=[0], episode_starts=[start])
        self._samples: SimpleQueue[SampleView | None] = SimpleQueue()
        self.commands: SimpleQueue[Values | Exception] = SimpleQueue()
        self._current: SampleView | None = None

    def exchange(self, sample: SampleView) -> Values:
        """Pass a sample to the environment, and return the commands that follow from it."""
        self._samples.put(sample)
        commands = self.commands.get()
        if isinstance(commands, Exception):
            raise commands
        return commands

    def cancel(self) -> None:
        """End the thread of the environment."""
        self._samples.put(None)

    def reset(self, *, seed: int | None = None) -> SampleView:  # noqa: ARG002
        """Return the first sample."""
        return self.receive()

    def receive(self) -> SampleView:
        """Wait for the next sample."""
        self._current = self._samples.get()
        if self._current is None:
            raise _Canceled
        return self._current

    def send(self, values: Floats, operations: bytes | None = None) -> None:
        """Pass the commands on."""
        self.commands.put(named_values(self.manifest, values, operations))

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Return columns of the weather of the node's episode."""
        assert self._current is not None
        return self._current.weather(columns)

    def close(self) -> None:
        """Do nothing: the link to the node belongs to somebody else."""
