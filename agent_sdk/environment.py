"""A building on the bus as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent_sdk import spaces
from agent_sdk.client import connect
from agent_sdk.launch import OwnNode
from agent_sdk.link import ControlLink
from agent_sdk.rewards import LinearReward, Reward
from agent_sdk.sample import SampleView
from bridge.affinity import Affinity
from topics.errors import EpisodeChanged, InvalidAction, InvalidConfig

Observation = NDArray[np.float32]

_PER_NODE = ("building", "weather", "sensors", "meters", "actuators", "begin", "end", "steps_per_hour", "keep")


class BuildingEnv(gym.Env[Observation, NDArray[np.float32]]):
    """One building, one agent; `gym.make("zenostat/Building-v1", ...)`.

    Without `connect` it starts a node of its own over a private unix socket and ends it on `close()`; with
    `connect` and `node` it drives a node that runs elsewhere.

    Observation: float32, shape (sensors + meters,), in the order of the manifest. Action: float32, shape
    (actuators,), within each actuator's bounds. An episode of N timesteps has N steps; the last one is
    `truncated`. `terminated` is never set.

    Args:
        building: short name, path to an IDF or epJSON, or any part of a listed name that fits only one.
        weather: short name, path to an EPW, or any part of a listed name that fits only one.
        sensors: name to (variable, key) or (variable, key, reading); reading is "mean", "sum" or "instant".
        meters: name to EnergyPlus's meter.
        actuators: name to (component type, control type, key), or that with low and high. Empty: the
            building's own control. Each of the three left out: a sensible set found in the model.
        begin, end: first and last day, MM-DD or YYYY-MM-DD.
        steps_per_hour: timesteps an hour; None is the model's own.
        reward: None gives 0.0.
        connect: endpoint of a bus.
        node: the node's name there.
        level: priority level that this agent commands at, 1 to 16.
        keep: folder in which EnergyPlus's own output files are kept, one folder an episode.
        affinity: see `bridge.affinity`.

    Raises:
        UsageError, BusError, SimulatorError: see `topics.errors`; nothing is left behind.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  # Gymnasium's own form

    def __init__(
        self,
        building: str | Path | None = None,
        weather: str | Path | None = None,
        *,
        sensors: Mapping[str, Sequence[str]] | None = None,
        meters: Mapping[str, str] | None = None,
        actuators: Mapping[str, Sequence[str | float]] | None = None,
        begin: str | None = None,
        end: str | None = None,
        steps_per_hour: int | None = None,
        reward: Reward | None = LinearReward(),  # noqa: B008  # frozen
        connect: str | None = None,
        node: str | None = None,
        level: int = 10,
        keep: str | Path | None = None,
        affinity: Affinity | str = Affinity.APART,
    ) -> None:
        decided = (building, weather, sensors, meters, actuators, begin, end, steps_per_hour, keep)
        given = dict(zip(_PER_NODE, decided, strict=True))
        self._close = ExitStack()
        with ExitStack() as undo:
            undo.callback(self.close)
            self.link = self._open(given, connect, node, level, Affinity(affinity))
            manifest = self.manifest = self.link.manifest
            self.observation_space = spaces.observation_space(manifest)
            self.action_space = actions = spaces.action_space(manifest)
            self._reward = reward.bind(manifest) if reward is not None else None
            undo.pop_all()
        self._space_low, self._space_high = actions.low, actions.high
        self._low = np.array([-np.inf if a.low is None else a.low for a in manifest.actuators])
        self._high = np.array([np.inf if a.high is None else a.high for a in manifest.actuators])
        self._timestep = timedelta(hours=1 / manifest.steps_per_hour)
        self._sample: SampleView | None = None

    def _open(
        self, given: dict[str, Any], endpoint: str | None, node: str | None, level: int, placement: Affinity
    ) -> ControlLink:
        """Finds a node elsewhere or starts one, and takes control of it."""
        core = None
        if endpoint is None:
            if given["building"] is None or given["weather"] is None:
                raise InvalidConfig("name a building and a weather, or the bus (connect=) and node of a running one")
            own = OwnNode(_settings(given, node or "building"), placement)
            self._close.callback(own.close)
            self.own_node: OwnNode | None = own
            endpoint, node, core = own.endpoint, node or "building", own.core
        else:
            self.own_node = None
            twice = [name for name, value in given.items() if value is not None]
            if twice:
                raise InvalidConfig(
                    f"{', '.join(twice)}: the node at {endpoint} has its own; leave out what it decides"
                )
            if node is None:
                raise InvalidConfig(f"connect={endpoint!r} needs the node's name: node='office'")
        bus = self._close.enter_context(connect(endpoint, affinity=placement, core=core))
        return self._close.enter_context(bus.controller(node, name="env", level=level))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode: sample 0, the state after warm-up, and its info."""
        super().reset(seed=seed)
        if options:
            raise InvalidConfig(f"unknown reset options {sorted(options)}; there are none")
        self._sample = self.link.reset(seed=seed)
        return self._sample.values.astype(np.float32), self._info(self._sample)

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulates one timestep under `action`.

        Raises:
            InvalidAction: wrong shape, out of bounds, or not finite; nothing was simulated.
            NodeLost, SimulatorError, Refused, EpisodeChanged: see `ControlLink.receive`.
        """
        previous = self._sample
        if previous is None or previous.truncated:
            raise EpisodeChanged("the episode is over; call reset()" if previous else "call reset() before step()")
        self.link.send(self._checked(action))
        sample = self._sample = self.link.receive()
        values, info = sample.values, self._info(sample)
        reward = 0.0
        if self._reward is not None:
            total, info["reward_terms"] = self._reward(values, sample.time - self._timestep)
            reward = float(total)
        return values.astype(np.float32), reward, False, sample.truncated, info

    def _checked(self, action: ArrayLike) -> NDArray[np.float64]:
        values = np.asarray(action, np.float64)
        if values.shape != self._low.shape:
            raise InvalidAction(f"action of shape {values.shape}; {self._low.shape} expected: {self._actuator_names()}")
        if not self._inside(values).all():
            raise InvalidAction(self._fault(values))
        # The space's float32 bounds may lie a rounding error outside the actuators' own.
        return np.clip(values, self._low, self._high)

    def _inside(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        finite = np.isfinite(values)  # an unbounded actuator takes any finite value
        return finite & (values >= self._space_low) & (values <= self._space_high)

    def _actuator_names(self) -> str:
        return ", ".join(a.name for a in self.manifest.actuators) or "the building's own control"

    def _fault(self, values: NDArray[np.float64]) -> str:
        faults = []
        for index in np.flatnonzero(~self._inside(values)):
            actuator = self.manifest.actuators[index]
            bounds = f"{self._low[index]:g} to {self._high[index]:g} {actuator.unit}"
            faults.append(f"{actuator.name} = {values[index]:g}; its bounds are {bounds}")
        return "; ".join(faults)

    def _info(self, sample: SampleView) -> dict[str, Any]:
        return {
            "time": sample.wire.time[0],
            "step": sample.step,
            "applied": sample.applied,
            "late": sample.wire.late,
            "rejected": sample.wire.rejected,
        }

    def observation_dict(self, observation: ArrayLike) -> dict[str, float]:
        """The observation's values by name, in the unit that the manifest says."""
        values = np.asarray(observation).tolist()
        return dict(zip(self.manifest.names, values, strict=True))

    def close(self) -> None:
        """Lets go of the node, and ends it if it is this environment's own; twice is fine."""
        self._close.close()


def _settings(given: dict[str, Any], name: str) -> dict[str, Any]:
    """What the user gave, as a node's settings."""
    settings: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    for key in ("building", "weather"):
        settings[key] = str(settings[key])
    for key in ("sensors", "actuators"):
        if key in settings:
            settings[key] = {n: _listed(key, n, spec) for n, spec in settings[key].items()}
    if "meters" in settings:
        settings["meters"] = dict(settings["meters"])
    if "keep" in settings:
        settings["keep"] = str(Path(settings["keep"]).absolute())
    # A relative path is the caller's, who may be elsewhere than the node.
    for key in ("building", "weather"):
        if Path(settings[key]).suffix:
            path = Path(settings[key]).expanduser()
            settings[key] = str(path.absolute()) if path.exists() else settings[key]
    return settings | {"name": name}


def _listed(what: str, name: str, spec: Any) -> list[Any]:
    if isinstance(spec, str) or not isinstance(spec, Sequence):
        raise InvalidConfig(f"{what} {name!r}: a tuple of EnergyPlus's names expected, got {spec!r}")
    return list(spec)
