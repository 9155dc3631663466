"""Several copies of a running episode as a vector environment, which also simulates whole plans."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NoReturn

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray
from zenoh import ZError

from zenostat.agent_sdk.envs.action_values import as_array
from zenostat.agent_sdk.envs.connection import one_caller
from zenostat.agent_sdk.envs.vector_env import BuildingVectorEnv, Observations, check_count
from zenostat.agent_sdk.envs.vector_infos import Infos
from zenostat.agent_sdk.envs.vector_sample import VectorSample
from zenostat.agent_sdk.rewards import BoundReward, Reward
from zenostat.agent_sdk.rewards.base import Begin, Outcome
from zenostat.agent_sdk.rewards.terms import TermSum
from zenostat.bridge.client.connection import Connection
from zenostat.bridge.client.controller_link import ControllerLink, open_link
from zenostat.bridge.client.sample import SampleView
from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import (
    BusError,
    EpisodeChanged,
    InvalidAction,
    InvalidConfig,
    NodeLost,
    NodeNotFound,
    RequestRejected,
)
from zenostat.topics.messages import CommandOp, CreateBranch, EpisodeStart, Sample, SimulatePlan

_REPLY_BYTES = codec.MAX_BYTES // 2
_MAX_TIMESTEPS = 1000

MAX_ERROR_K = 50.0


@dataclass(frozen=True, slots=True)
class Rollout:
    """The outcome of a plan in each slot.

    Attributes:
        rewards: shape (slots, timesteps), float64; 0 after the end of an episode.
        observations: shape (slots, timesteps, *observation shape), float32; after the end, the last one.
        lengths: number of timesteps until the end of the episode or the plan, shape (slots,).
        terminated: whether a limit of the scenario was violated, shape (slots,).
        truncated: whether the run period ended, shape (slots,).
        terms: terms of the rewards by name, shape (slots, timesteps), 0 after the end; empty without a reward.
        metrics: the quantities behind the rewards by name, in the same form.
    """

    rewards: Floats
    observations: NDArray[np.float32]
    lengths: NDArray[np.intp]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    terms: dict[str, Floats]
    metrics: dict[str, Floats]


class BranchVectorEnv(BuildingVectorEnv):
    """Branches of one environment's episode that step together; `BuildingEnv.branch(slots=k)` creates it.

    It has the interface of `BuildingVectorEnv`, but a single episode in each slot: it cannot be reset. `plan` simulates
    many timesteps in one request, with the same results as `step` to the bit.

    Args:
        link: link to the branch.
        reward: the reward of the parent; None if there is none.
        sample: the parent's sample at which the branches start.
        state: captured state of the parent's episode.
        start: entries of the parent's infos that describe the start of its episode.
        undo: closes the branch; the environment takes it over.
        scheduled: values of the points at the samples of the episode, by step, where they are known; those of schedules
            are read by later branches of the same episode. The environment adds to it.
    """

    def __init__(
        self,
        link: ControllerLink,
        reward: Reward | None,
        sample: SampleView,
        state: Mapping[str, Any],
        start: Infos,
        undo: ExitStack,
        scheduled: dict[int, Floats] | None = None,
    ) -> None:
        self._scheduled = {} if scheduled is None else scheduled
        count = link.manifest.slots
        super().__init__(count, autoreset_mode=AutoresetMode.DISABLED, reward=reward, link=link)
        self._branch_link = link
        state = copy.deepcopy(dict(state))
        bound = self._state.reward
        # A function of the user's is written for one building, and a state is that of one building.
        if bound is not None and (state["reward"] or not isinstance(bound, TermSum)):
            bound.restore(state["reward"])
            self._state.reward = _RewardPerSlot([copy.deepcopy(bound) for _ in range(count)])
        if self._state.limits is not None:
            self._state.limits.adopt(state["limits"])
        self._state.context = [dict(state["context"]) for _ in range(count)]
        self._state.programs = state["programs"]
        self._sample = VectorSample(link.set_current(_repeated(sample, count)))
        episode_start = EpisodeStart(
            engine_start=start["engine_start"], weather=start["weather"], noise_parameters=start["weather_noise"]
        )
        self._infos.start_episodes(range(count), [episode_start] * count, self._add_info)
        self._connection.push_exit(undo.pop_all())

    def __enter__(self) -> BranchVectorEnv:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def snapshot(self) -> NoReturn:
        """Raise `InvalidConfig`: a branch has no snapshots."""
        raise InvalidConfig("a branch has no snapshots; take one of its environment")

    def _restarting_slots(self) -> list[int]:
        if self.closed or self._done.any() or self._sample is None:
            self._connection.check_open()
            raise EpisodeChanged(
                "the episode is over in a slot of this branch, or was interrupted; close it and make another one"
            )
        return []

    def plan(self, actions: ArrayLike) -> Floats:
        """Simulate a sequence of actions in each slot; return the rewards, shape (slots, timesteps); see `rollout`."""
        return self.rollout(actions).rewards

    @one_caller
    def rollout(self, actions: ArrayLike) -> Rollout:
        """Simulate a sequence of actions in each slot, in one request to the node.

        Args:
            actions: elements of the single environment's action space, shape (slots, timesteps, *action shape). A slot
                whose episode ends ignores the rest.

        Raises:
            InvalidAction: wrong shape, out of bounds, not finite, or no such choice; nothing was simulated.
            NodeLost, SimulatorError, RequestRejected, EpisodeChanged: see `ControllerLink.receive`.
        """
        self._restarting_slots()
        sequences = self._sequences(actions)
        timesteps = sequences.shape[1]
        rewards = np.zeros((self.num_envs, timesteps))
        lengths = np.full(self.num_envs, timesteps)
        terminated, truncated = np.zeros(self.num_envs, np.bool_), np.zeros(self.num_envs, np.bool_)
        observations: list[Observations] = []
        outcomes = _OutcomeSeries(self.num_envs, timesteps)
        number = 0
        for sample in self._samples(sequences):
            live = ~self._done
            outcome, observed, ended, at_end = self._evaluated(sample)
            if outcome is not None:
                rewards[live, number] = np.broadcast_to(outcome.reward, live.shape)[live]
                outcomes.add(number, outcome, live)
            observations.append(np.where(live.reshape(-1, *[1] * (observed.ndim - 1)), observed, self._observations))
            self._observations = observations[-1]
            terminated |= ended & live
            truncated |= at_end & live
            number += 1
            lengths[live & (ended | at_end)] = number
            self._done |= ended | at_end
        observations += [self._observations] * (timesteps - number)
        return Rollout(
            rewards, np.stack(observations, axis=1), lengths, terminated, truncated, outcomes.terms, outcomes.metrics
        )

    def _evaluated(
        self, sample: VectorSample
    ) -> tuple[Outcome | None, Observations, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return rewards, observations, and whether it is terminated and truncated, of each slot."""
        self._sample = sample
        ends, state, values = sample.times, self._state, sample.fault_free_values
        begins = [end - self._timestep for end in ends]
        outcome, terminated = None, np.zeros(self.num_envs, np.bool_)
        if state.reward is not None:
            outcome = state.reward(values, begins)
        if state.limits is not None:
            terminated[list(state.limits.violated_slots(values))] = True
        return outcome, sample.observed(begins, ends, self._observed_indices), terminated, sample.truncated

    def _sequences(self, actions: ArrayLike) -> NDArray[Any]:
        """Return actions as an array, shape (slots, timesteps, *action shape); all are checked."""
        sequences = as_array(actions, None)
        single = self.single_action_space.shape or ()
        if sequences.ndim != 2 + len(single) or not sequences.shape[1]:
            raise InvalidAction(
                f"actions of shape {sequences.shape}; expected ({self.num_envs} slots, at least 1 timestep"
                f"{''.join(f', {length}' for length in single)})"
            )
        for number in range(sequences.shape[1]):
            try:
                self._actions.rows(sequences[:, number], self.num_envs)
            except InvalidAction as error:
                raise InvalidAction(f"timestep {number}: {error}") from None
        return sequences

    def _samples(self, sequences: NDArray[Any]) -> Iterator[VectorSample]:
        """Simulate; yield the sample of each timestep, until all episodes have ended."""
        if not self._actions.is_relative:
            yield from self._simulate(*self._encoded(sequences, ()))
            return
        first = 0
        while first < sequences.shape[1] and not self._done.all():
            points = self._known_points(sequences.shape[1] - first)
            for sample in self._simulate(*self._encoded(sequences[:, first : first + len(points)], points)):
                yield sample
                first += 1

    def _known_points(self, most: int) -> list[Floats]:
        """Return the points at the present sample and, as far as they are known, at those that follow it.

        An offset is relative to the sample of its timestep. A later one is read only if all values that it needs are
        those of schedules, which do not depend on actions.
        """
        assert self._sample is not None
        live = int((~self._done).argmax())
        step = self._sample.message.step[live]
        points = [self._sample.fault_free_values]
        if self._actions.is_scheduled:
            self._scheduled[step] = self._sample.fault_free_values[live].copy()
            while len(points) < most and step + len(points) in self._scheduled:
                points.append(np.tile(self._scheduled[step + len(points)], (self.num_envs, 1)))
        return points

    def _encoded(self, sequences: NDArray[Any], points: Sequence[Floats]) -> tuple[Floats, NDArray[np.uint8] | None]:
        """Return commands and operations of each timestep, shape (timesteps, slots, actuators).

        Args:
            sequences: shape (slots, timesteps, *action shape).
            points: points at the sample of each timestep; empty if no action is relative to them.
        """
        assert self._sample is not None
        begin = self._begin()
        values, codes = [], []
        for number in range(sequences.shape[1]):
            self._state.apply_programs(begin + number * self._timestep, self.set_context)
            values.append(self._actions.rows(sequences[:, number], self.num_envs))
            at = points[number] if points else self._sample.fault_free_values
            codes.append(self._actions.complete(values[-1], at, self._state.context))
        if all(code is None for code in codes):
            return np.stack(values), None
        every = bytes([CommandOp.SET]) * values[0].size
        joined = b"".join(every if code is None else code for code in codes)
        return np.stack(values), np.frombuffer(joined, np.uint8).reshape(len(codes), *values[0].shape)

    def _command(self, actions: ArrayLike, unread: Sequence[int]) -> tuple[Floats, bytes | None]:
        self._state.apply_programs(self._begin(), self.set_context)
        return super()._command(actions, unread)

    def _begin(self) -> datetime:
        """Return the time at which the next timestep begins; the running slots have the same."""
        assert self._sample is not None
        return self._sample.times[int((~self._done).argmax())]

    def _simulate(self, values: Floats, operations: NDArray[np.uint8] | None) -> list[VectorSample]:
        link = self._branch_link
        samples: list[VectorSample] = []
        most = self._timesteps_per_request()
        for first in range(0, len(values), most):
            assert self._sample is not None
            message = samples[-1].message if samples else self._sample.message
            part = slice(first, first + most)
            request = SimulatePlan(
                controller=link.name,
                episode=message.episode,
                step=message.step,
                timesteps=len(values[part]),
                operations=None if operations is None else operations[part].tobytes(),
                values=np.ascontiguousarray(values[part], codec.FLOAT).tobytes(),
            )
            try:
                reply = link.bus.plan(self.manifest.node, request)
            except NodeNotFound:
                raise link.bus.lost(self.manifest.node) from None
            samples += [VectorSample(link.set_current(codec.decode(Sample, raw))) for raw in reply.samples]
            if len(reply.samples) < len(values[part]):
                break
        return samples

    def _timesteps_per_request(self) -> int:
        points = len(self.manifest.sensors) + len(self.manifest.meters)
        size = self.num_envs * (8 * 2 * points + 8 * 3 * len(self.manifest.actuators) + 100) + 4000
        return max(1, min(_MAX_TIMESTEPS, _REPLY_BYTES // size))


class _OutcomeSeries:
    """Terms and metrics of the rewards of several timesteps.

    Attributes:
        terms, metrics: by name, shape (slots, timesteps).
    """

    def __init__(self, slots: int, timesteps: int) -> None:
        self._shape = (slots, timesteps)
        self.terms: dict[str, Floats] = {}
        self.metrics: dict[str, Floats] = {}

    def add(self, timestep: int, outcome: Outcome, live: NDArray[np.bool_]) -> None:
        """Add the outcomes of the slots whose episodes go on."""
        for series, values in ((self.terms, outcome.terms), (self.metrics, outcome.metrics)):
            for name, value in values.items():
                column = series.setdefault(name, np.zeros(self._shape))[:, timestep]
                column[live] = np.broadcast_to(np.asarray(value, np.float64), live.shape)[live]


class _RewardPerSlot(BoundReward):
    """Rewards of single buildings, each with its own state, as the reward of a vector."""

    def __init__(self, rewards: Sequence[BoundReward]) -> None:
        self._rewards = rewards

    def __call__(self, values: Floats, begin: Begin) -> Outcome:
        begins = begin if isinstance(begin, Sequence) else [begin] * len(values)
        outcomes = [reward(row, at) for reward, row, at in zip(self._rewards, values, begins, strict=True)]
        terms = {name: np.array([outcome.terms[name] for outcome in outcomes]) for name in outcomes[0].terms}
        metrics = {name: np.array([outcome.metrics[name] for outcome in outcomes]) for name in outcomes[0].metrics}
        return Outcome(np.array([float(outcome.reward) for outcome in outcomes]), terms, metrics)


def _repeated(sample: SampleView, count: int) -> Sample:
    """Return the message of one slot's sample as that of several slots."""
    message, slot, slots = sample.message, sample.slot, sample.manifest.slots

    def raw(field: bytes) -> bytes:
        width = len(field) // slots
        return field[slot * width : (slot + 1) * width] * count

    lists = ("episode", "step", "time", "elapsed_s", "flags")
    arrays = ("values", "effective", "commanded", "source_index", "fault_free_values")
    return message.model_copy(
        update={name: [getattr(message, name)[slot]] * count for name in lists}
        | {name: raw(getattr(message, name)) for name in arrays}
        | {"baseline": b"", "baseline_effective": b""}
    )


def branch_request(
    controller: str, snapshot: str, slots: int | None, forecast_error: Sequence[float], *, relinquished: bool
) -> CreateBranch:
    """Return the request for a branch.

    Raises:
        InvalidConfig: a number of slots or an error out of range, or errors that are not a sequence of numbers.
    """
    count = 1 if slots is None else check_count(slots, "slots")
    try:
        errors = [float(error) for error in forecast_error]
    except (TypeError, ValueError):
        raise InvalidConfig(
            f"forecast_error = {forecast_error!r}; a sequence of numbers in K expected, one for each timestep"
        ) from None
    if not all(abs(error) <= MAX_ERROR_K for error in errors):  # NaN is not
        raise InvalidConfig(f"forecast_error = {errors}; numbers from -{MAX_ERROR_K:g} to {MAX_ERROR_K:g} K expected")
    return CreateBranch(
        controller=controller, snapshot=snapshot, slots=count, relinquished=relinquished, forecast_error=errors
    )


def open_branch(parent: ControllerLink, request: CreateBranch, priority: int, undo: ExitStack) -> ControllerLink:
    """Create a branch and return a link to it; `undo` disconnects it and ends the branch.

    Raises:
        NodeLost: the node was restarted, or another node has the branch's name.
        RequestRejected, ForkFailed, NodeNotFound: see `Connection.branch` and `open_link`.
    """
    name = parent.bus.branch(parent.manifest.node, request)
    undo.callback(_stop, parent.bus, name, parent.manifest.instance)
    link = undo.enter_context(open_link(parent.bus, name, name="env", priority=priority))
    if link.manifest.instance != parent.manifest.instance:
        raise NodeLost(f"node {name!r} is not the branch: its node was restarted, or another node has this name")
    return link


def _stop(bus: Connection, node: str, instance: str) -> None:
    with suppress(BusError, RequestRejected, ZError):  # it has ended with its parent, or the bus is closed
        bus.stop(node, instance=instance)
