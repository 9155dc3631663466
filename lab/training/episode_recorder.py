"""Record the actions of running episodes, and return to them in a new environment by repeating the actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from zenostat.topics.errors import UsageError


@dataclass(frozen=True)
class RunningEpisodes:
    """The episodes that run in the slots of an environment.

    Attributes:
        numbers: of each slot, the number of episodes before the running one.
        actions: of each slot, its actions in the running episode, shape (steps, …).
    """

    numbers: tuple[int, ...]
    actions: tuple[NDArray[Any], ...]


class EpisodeRecorder(VecEnvWrapper):  # type: ignore[misc,unused-ignore]  # without types where it is not installed
    """Records for each slot the number of its episode and the actions in it, and checks observations.

    Args:
        venv: the environment.
        names: of the building's observations.
    """

    def __init__(self, venv: VecEnv, names: Sequence[str] = ()) -> None:
        super().__init__(venv)
        self._names = names
        self._numbers = [0] * self.num_envs
        self._begins = [0] * self.num_envs
        self._actions: list[NDArray[Any]] = []

    def reset(self) -> Any:
        """Start the first episodes."""
        self._numbers, self._begins, self._actions = [0] * self.num_envs, [0] * self.num_envs, []
        return self._checked(self.venv.reset())

    def step_async(self, actions: NDArray[Any]) -> None:
        """Record the actions and pass them on."""
        self._actions.append(np.array(actions))
        self.venv.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Return the results of the step, and count the episodes that ended."""
        result = self.venv.step_wait()
        self._checked(result[0])
        for slot in np.flatnonzero(result[2]).tolist():
            self._numbers[slot] += 1
            self._begins[slot] = len(self._actions)
        if (unused := min(self._begins)) > 0:
            del self._actions[:unused]
            self._begins = [begin - unused for begin in self._begins]
        return result

    def _checked(self, observations: Any) -> Any:
        """Return observations; NaN would make all weights NaN.

        Raises:
            UsageError: one is no finite number.
        """
        if not isinstance(observations, np.ndarray) or np.isfinite(observations).all():
            return observations
        slot, column = np.argwhere(~np.isfinite(observations))[0][:2].tolist()
        is_plain = observations.shape[1:] == (len(self._names),)  # no wrapper has changed it
        name = self._names[column] if is_plain else f"number {column}"
        raise UsageError(
            f"the observation {name} is {observations[slot, column]}: training needs finite numbers; leave the point "
            "out (unobserved) if a fault drops its values, or replace them in a wrapper"
        )

    def running(self) -> RunningEpisodes:
        """Return the running episodes."""
        rows = [[step[slot] for step in self._actions[begin:]] for slot, begin in enumerate(self._begins)]
        return RunningEpisodes(tuple(self._numbers), tuple(map(np.array, rows)))

    def adopt(self, episodes: RunningEpisodes) -> None:
        """Continue the record of episodes to which `repeat` has returned."""
        lengths = [len(actions) for actions in episodes.actions]
        longest = max(lengths)
        self._numbers, self._begins = list(episodes.numbers), [longest - length for length in lengths]
        empty = next((actions[0] for actions in episodes.actions if len(actions)), None)
        self._actions = [
            np.array([actions[step - begin] if step >= begin else empty
                      for actions, begin in zip(episodes.actions, self._begins, strict=True)])
            for step in range(longest)
        ]  # fmt: skip


def repeat(monitor: VecMonitor, recorder: EpisodeRecorder, env: Any, seed: int, episodes: RunningEpisodes) -> None:
    """Bring the slots of a new environment to where recorded episodes are.

    The first episodes are started with the seeds, and further ones until each slot is in its recorded episode, because
    an episode's weather and noise follow from the seed and the number of episodes since. Then the actions are repeated.
    Where slots are at different steps, those that are less far begin later.

    Args:
        monitor: the outermost layer to repeat them in.
        recorder: the layer below it, which continues the record.
        env: the environment of Gymnasium below it.
        seed: seed of the first episode of slot 0.
        episodes: where to go.
    """
    count = len(episodes.numbers)
    lengths = [len(actions) for actions in episodes.actions]
    longest = max(lengths)
    monitor.seed(seed)
    monitor.reset()
    _advance(env, episodes.numbers, range(count))
    fill = episodes.actions[lengths.index(longest)]
    for step in range(longest + 1):
        late = [slot for slot in range(count) if longest - lengths[slot] == step and step > 0]
        if late:
            _restart(env, late, seed, count)
            _advance(env, episodes.numbers, late)
            monitor.episode_returns[late], monitor.episode_lengths[late] = 0, 0
        if step < longest:
            begins = [longest - length for length in lengths]
            rows = [
                actions[step - begin] if step >= begin else fill[step]
                for actions, begin in zip(episodes.actions, begins, strict=True)
            ]
            monitor.step(np.array(rows))
    recorder.adopt(episodes)


def _restart(env: Any, slots: Sequence[int], seed: int, count: int) -> None:
    mask = np.isin(np.arange(count), slots)
    seeds = [seed + slot if mask[slot] else None for slot in range(count)]
    env.reset(seed=seeds, options={"reset_mask": mask})


def _advance(env: Any, numbers: Sequence[int], slots: Sequence[int]) -> None:
    """Start episodes in slots, which are in their first one, until they are in those with these numbers."""
    for number in range(max((numbers[slot] for slot in slots), default=0)):
        if not hasattr(env, "num_envs"):
            env.reset()
            continue
        env.reset(options={"reset_mask": np.array([s in slots and numbers[s] > number for s in range(len(numbers))])})
