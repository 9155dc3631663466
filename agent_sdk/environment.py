"""A building on the bus as a Gymnasium environment."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent_sdk import settings, spaces
from agent_sdk.actions import Actions
from agent_sdk.client import connect
from agent_sdk.clock import clock
from agent_sdk.launch import OwnNode
from agent_sdk.link import ControlLink
from agent_sdk.rewards import Reward, read_reward
from agent_sdk.sample import SampleView
from bridge.affinity import Affinity
from topics.errors import EpisodeChanged, InvalidConfig
from topics.messages import Mask, WeatherSeries

Observation = NDArray[np.float32]
NAME = "building"


class BuildingEnv(gym.Env[Observation, Any]):
    """One building, one agent; `gym.make("zenostat/5zone-hot-continuous-v1")` and all others under `zenostat/`.

    Without `connect` it starts a node of its own over a private unix socket and ends it on `close()`; with
    `connect` and `node` it drives a node that runs elsewhere, whose scenario it takes over.

    Observation: float32, shape (time fields + sensors + meters,), in the order of the manifest. Action: float32,
    shape (actions,), within each action's bounds, or a number for each discrete choice. An episode of N timesteps
    has N steps; the last one is `truncated`. `terminated` is never set.

    What is simulated comes from `scenario`, `file` or `config`, or from `building` and `weather`; each argument
    that is given goes before what those say.

    Args:
        building: short name, path to an IDF or epJSON, or any part of a listed name that fits only one.
        weather: short name, path to an EPW, or any part of a listed name that fits only one; or several of them.
        scenario: an id, as `zenostat scenarios` lists them.
        file: a scenario file (YAML).
        config: a Sinergym configuration (YAML), of which `variant` names the weather and form
            (`hot-continuous-stochastic`; its first one if left out).
        sensors: name to (variable, key) or (variable, key, reading); reading is "mean", "sum" or "instant".
        meters: name to EnergyPlus's meter.
        actuators: name to (component type, control type, key), or that with low and high. Empty: the
            building's own control. Each of the three left out: a sensible set found in the model.
        begin, end: first and last day, MM-DD or YYYY-MM-DD.
        steps_per_hour: timesteps an hour; None is the model's own.
        weather_order, variability, sizing, changes, time, reading, actions, control, discrete: as in a scenario file
            (`zenostat scenarios schema`).
        reward: an object of `agent_sdk.rewards`, or a kind or a kind with its parameters; None gives 0.0;
            left out, the scenario's.
        connect: endpoint of a bus.
        node: the node's name there.
        level: priority level that this agent commands at, 1 to 16.
        keep: folder in which EnergyPlus's own output files are kept, one folder an episode.
        affinity: see `bridge.affinity`.

    Raises:
        UsageError, BusError, SimulatorError: see `topics.errors`; nothing is left behind.

    Warns:
        UserWarning: something in the model works against the scenario's actuators.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  # Gymnasium's own form

    def __init__(
        self,
        building: str | Path | None = None,
        weather: str | Path | Sequence[str | Path] | None = None,
        *,
        scenario: str | None = None,
        file: str | Path | None = None,
        config: str | Path | None = None,
        variant: str | None = None,
        sensors: Mapping[str, Sequence[str]] | None = None,
        meters: Mapping[str, str] | None = None,
        actuators: Mapping[str, Sequence[str | float]] | None = None,
        begin: str | None = None,
        end: str | None = None,
        steps_per_hour: int | None = None,
        weather_order: str | None = None,
        variability: Mapping[str, Any] | None = None,
        sizing: str | None = None,
        changes: Mapping[str, Any] | None = None,
        time: Sequence[str] | None = None,
        reading: str | None = None,
        actions: Mapping[str, Any] | None = None,
        control: str | None = None,
        discrete: int | Sequence[Any] | None = None,
        reward: Reward | Mapping[str, Any] | str | None = settings.OF_THE_SCENARIO,
        connect: str | None = None,
        node: str | None = None,
        level: int = 10,
        keep: str | Path | None = None,
        affinity: Affinity | str = Affinity.APART,
    ) -> None:
        here = locals()
        given = {name: here[name] for name in settings.OF_A_NODE if here[name] is not None}
        self._close = ExitStack()
        with ExitStack() as undo:
            undo.callback(self.close)
            self.link = self._open(given, reward, connect, node, level, Affinity(affinity))
            manifest = self.manifest = self.link.manifest
            self.observation_space = spaces.observation_space(manifest)
            self._actions = Actions(manifest)
            self.action_space = self._actions.space
            rewarding = self._rewarding(reward)
            self._reward = rewarding.bind(manifest) if rewarding is not None else None
            undo.pop_all()
        self._timestep = timedelta(hours=1 / manifest.steps_per_hour)
        self._time = manifest.task.time
        self._values = self._actions.values
        self._sample: SampleView | None = None
        self._context: dict[int, float | None] = {}
        for warning in manifest.warnings:
            warnings.warn(f"{manifest.building}: {warning}", stacklevel=3)

    def _open(
        self,
        given: dict[str, Any],
        reward: Reward | Mapping[str, Any] | str | None,
        endpoint: str | None,
        node: str | None,
        level: int,
        placement: Affinity,
    ) -> ControlLink:
        """Finds a node elsewhere or starts one, and takes control of it."""
        core = None
        if endpoint is None:
            wanted = settings.for_node(given, node or NAME)
            settings.check_reward(reward, wanted, placement)
            own = OwnNode(wanted, placement)
            self._close.callback(own.close)
            self.own_node: OwnNode | None = own
            endpoint, node, core = own.endpoint, node or NAME, own.core
        else:
            self.own_node = None
            if given:
                raise InvalidConfig(
                    f"{', '.join(given)}: the node at {endpoint} has its own; leave out what it decides"
                )
            if node is None:
                raise InvalidConfig(f"connect={endpoint!r} needs the node's name: node='office'")
        bus = self._close.enter_context(connect(endpoint, affinity=placement, core=core))
        return self._close.enter_context(bus.controller(node, name="env", level=level))

    def _rewarding(self, reward: Reward | Mapping[str, Any] | str | None) -> Reward | None:
        wanted = self.manifest.task.reward if reward == settings.OF_THE_SCENARIO else reward
        return read_reward(wanted) if isinstance(wanted, str | Mapping) else wanted

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode: sample 0, the state after warm-up, and its info.

        The seed rules which weather is drawn and its noise; without one, the next of the sequence that the last
        seed began. `info["weather"]` says which it is.
        """
        super().reset(seed=seed)
        if options:
            raise InvalidConfig(f"unknown reset options {sorted(options)}; there are none")
        self._context = {}
        sample = self._sample = self.link.reset(seed=seed)
        info = self._info(sample)
        info["weather"], info["weather_noise"] = self.link.accepted.weather, self.link.accepted.drawn
        return self._observed(sample, sample.values, sample.time), info

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulates one timestep under `action`.

        Raises:
            InvalidAction: wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, Refused, EpisodeChanged: see `ControlLink.receive`.
        """
        previous = self._sample
        if previous is None or previous.truncated:
            raise EpisodeChanged("the episode is over; call reset()" if previous else "call reset() before step()")
        self.link.send(*self._command(action))
        sample = self._sample = self.link.receive()
        values, info, begin = sample.values, self._info(sample), sample.time - self._timestep
        reward = 0.0
        if self._reward is not None:
            total, info["reward_terms"] = self._reward(values, begin)
            reward = float(total)
        return self._observed(sample, values, begin), reward, False, sample.truncated, info

    def _command(self, action: ArrayLike) -> tuple[NDArray[np.float64], bytes | None]:
        values, mask = self._values(action), self._actions.mask
        if self._context:
            assert mask is not None
            kinds = bytearray(mask)
            for index, value in self._context.items():
                kinds[index] = Mask.RELEASE if value is None else Mask.SET
                values[index] = 0.0 if value is None else value
            mask, self._context = bytes(kinds), {}
        return values, mask

    def set_context(self, values: Mapping[str, float | None]) -> None:
        """Sets actuators that are in no action, from the next step on until it is called again; None releases one.

        Raises:
            InvalidAction: an actuator that the node does not have, or that an action sets; a value out of bounds.
        """
        self._context |= self._actions.context(values)

    def weather(self, columns: Sequence[str]) -> WeatherSeries:
        """Columns of the weather file that this episode reads, noise included; see `WeatherSeries`.

        Raises:
            UnknownName: no such column of an EPW.
        """
        return self.link.bus.weather(self.manifest.node, columns)

    def _observed(self, sample: SampleView, values: NDArray[np.float64], begin: Any) -> Observation:
        if not self._time:
            return values.astype(np.float32)
        return np.concatenate([clock(self._time, begin, sample.time), values]).astype(np.float32)

    def _info(self, sample: SampleView) -> dict[str, Any]:
        return {
            "time": sample.wire.time[0],
            "step": sample.step,
            "applied": sample.applied,
            "late": sample.wire.late,
            "rejected": sample.wire.rejected,
        }

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the observation's values: time fields, sensors, meters."""
        return (*map(str, self.manifest.task.time), *self.manifest.names)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the action's dimensions; of what the choices set where it is discrete."""
        return tuple(self._actions.names)

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """The observation's values by name, in the unit that the manifest says."""
        values = np.asarray(observation).tolist()
        return dict(zip(self.observation_names, values, strict=True))

    def close(self) -> None:
        """Lets go of the node, and ends it if it is this environment's own; twice is fine."""
        self._close.close()
