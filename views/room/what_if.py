"""The question "what if": the next hours of a running building with other commands, beside those as they are.

All futures are simulated on branches of the same sample, by a plan, so the building itself does not notice. Commands of
controllers stay as they are, since the controllers do not run on a branch; another controller can be tried in their
place, which answers each sample of its branch.
"""

from __future__ import annotations

import concurrent.futures
import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import partial
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from zenostat.agent_sdk.controllers import Agent, Values
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.command_publisher import CommandArrays
from zenostat.bridge.client.controller_link import ControllerLink, open_link
from zenostat.bridge.client.sample import SampleView
from zenostat.topics import codec, keys
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import BadMessage, InvalidAction, InvalidConfig, RequestRejected, ZenostatError
from zenostat.topics.messages import Ack, CommandOp, CreateBranch, Manifest, Sample, SimulatePlan, Write
from zenostat.topics.plurals import counted
from zenostat.topics.points import actuator_index, contains, describe_violation
from zenostat.views.room.description import MAX_FUTURE_STEPS, NodeDescription, longest_future_h
from zenostat.views.room.numbers import number, numbers
from zenostat.views.room.requests import RoomRequest
from zenostat.views.room.trial_controllers import BUNDLED, Factory, TrialController, semantic_model

_STEPS_PER_REQUEST = 48  # so that a large building answers in time
ANSWER_LIMIT_S = 30.0
"""Time that a controller has for each sample; some compile on their first."""

_REPLY_BYTES = codec.MAX_BYTES // 2


class WhatIf(RoomRequest):
    """Values to try for some actuators, or a controller, at a priority, for the next hours.

    The value None relinquishes an actuator there. By default it is a day, or the longest that can be simulated.
    """

    values: dict[str, float | None] = Field(default_factory=dict)
    controller: TrialController | None = None
    priority: Annotated[int, Field(ge=1, le=16)] = 8
    hours: Annotated[float | None, Field(gt=0, le=7 * 24)] = None

    @model_validator(mode="after")
    def _one_change(self) -> Self:
        if bool(self.values) == (self.controller is not None):
            raise ValueError("either values of actuators or a controller expected")
        return self


@dataclass(frozen=True)
class Future:
    """Commands of a future, in place of those as they are.

    Attributes:
        values: by actuator; None relinquishes it at the priority.
        priority: of the values, or of the controller, 1 (highest) to 16.
        is_relinquished: whether all other commands are relinquished: the future is that of the baseline control.
        controller: creates a controller for the manifest of a branch. It replaces the node's controllers, whose
            commands are relinquished; what persons and devices have written stays.
    """

    values: Mapping[str, float | None] = field(default_factory=dict)
    priority: int = 8
    is_relinquished: bool = False
    controller: Callable[[Manifest], Agent] | None = None


def what_if(
    bus: Bus,
    description: NodeDescription,
    request: WhatIf,
    operator: str,
    offered: Mapping[str, Factory] = BUNDLED,
    on_branch: Callable[[str], object] = lambda _: None,
) -> dict[str, Any]:
    """Return the values of all points and the totals of both futures.

    Args:
        bus: connection to the bus.
        description: of the node.
        request: values or controller to try.
        operator: name of who asks.
        offered: controllers that the request may name.
        on_branch: called with the name of each branch that is created.

    Raises:
        UnknownName, InvalidConfig: the controller, its parameters, a controller that the node does not suit, or one
            that fails.
        ZenostatError: as `simulate_futures`.
    """
    node, trial = description.manifest.node, request.controller
    changed = Future(request.values, request.priority)
    errors: AbstractContextManager[None] = nullcontext()
    if trial is not None:
        create_controller, errors = trial.creator(offered), trial.described_errors()

        def create(manifest: Manifest) -> Agent:
            return Agent(create_controller(manifest), semantic=lambda: semantic_model(bus, node))

        create(description.manifest)  # its errors come before anything is simulated
        changed = Future(priority=request.priority, controller=create)
    with errors:
        futures = {"as_is": Future(), "changed": changed}
        samples = simulate_futures(bus, description, futures, request.hours, operator, on_branch)
    return futures_content(description, samples)


def simulate_futures(
    bus: Bus,
    description: NodeDescription,
    futures: Mapping[str, Future],
    hours: float | None,
    operator: str,
    on_branch: Callable[[str], object] = lambda _: None,
) -> dict[str, list[Sample]]:
    """Return the present sample and those of the next hours under several commands, equally many for each.

    Args:
        bus: connection to the bus.
        description: of the node.
        futures: commands by the name of the future.
        hours: length, in simulated hours; None: a day, or the longest that can be simulated.
        operator: name of who asks.
        on_branch: called with the name of each branch that is created.

    Raises:
        InvalidConfig: the hours are shorter than a timestep, or too many; more values than the node has actuators.
        UnknownName, InvalidAction: a value of an actuator that does not exist, or beyond its bounds.
        RequestRejected: the node cannot branch now.
        ForkFailed: the system cannot fork the simulation.
        BadMessage: the node named a node that is none of its branches.
    """
    manifest = description.manifest
    if hours is None:
        hours = min(24.0, longest_future_h(manifest.step_s))
    steps, step_h = int(hours * 3600 / manifest.step_s + 1e-6), manifest.step_h
    if steps < 1:
        raise InvalidConfig(f"hours: at least a timestep of {step_h:g} h expected")
    if steps > MAX_FUTURE_STEPS:
        raise InvalidConfig(
            f"hours: at most {longest_future_h(manifest.step_s):g} h expected, {MAX_FUTURE_STEPS} timesteps of "
            f"{manifest.step_s:g} s"
        )
    for future in futures.values():
        _check_values(manifest, future.values)
    with ExitStack() as stack:
        owner = bus.sender(f"{operator}-what-if")
        # Its end ends the branches, even if this program is killed.
        token = bus.session.liveliness().declare_token(keys.CONTROLLER_TOKEN.at(manifest.node, sender=owner))
        stack.enter_context(token)
        snapshot = bus.snapshot(manifest.node, owner)
        stack.callback(_end, bus.drop, manifest.node, snapshot.snapshot, owner)
        branches = {}
        for name, future in futures.items():
            request = CreateBranch(controller=owner, snapshot=snapshot.snapshot, relinquished=future.is_relinquished)
            branch = bus.branch(manifest.node, request)
            on_branch(branch)
            if bus.manifest(branch).branch_of != manifest.node:
                raise BadMessage(f"{branch} is no branch of {manifest.node}")  # it may be another building
            stack.callback(_end, partial(bus.stop, branch, instance=manifest.instance))
            if future.controller is not None:
                _relinquish_controllers(bus, manifest.node, branch, operator)
            for point, value in future.values.items():
                bus.write(branch, point, value, priority=future.priority, source=operator)
            branches[name] = branch
        samples = {name: _simulate(bus, branch, steps, futures[name]) for name, branch in branches.items()}
    count = min(map(len, samples.values()))
    if count < 2:
        raise RequestRejected("the episode is over")
    return {name: each[:count] for name, each in samples.items()}


def _check_values(manifest: Manifest, values: Mapping[str, float | None]) -> None:
    """Raise the error of an unknown actuator, or of a value beyond the bounds, before anything is simulated."""
    index = actuator_index(manifest)
    if len(values) > len(index):
        limit = counted(len(index), "value")
        raise InvalidConfig(f"values: at most {limit} expected, one for each actuator of the node, not {len(values)}")
    index.require(values)
    for name, value in values.items():
        actuator = manifest.actuators[index[name]]
        if value is not None and not contains(actuator, value):
            raise InvalidAction(describe_violation(actuator, value))


def _end(end: Any, *arguments: str) -> None:
    with suppress(ZenostatError):  # it has ended already
        end(*arguments)


def _relinquish_controllers(bus: Bus, node: str, branch: str, operator: str) -> None:
    """Relinquish on a branch what the controllers of its node have commanded."""
    controllers = {status.controller for status in bus.status(node).controllers}
    for point, entries in bus.priorities(branch).items():
        for priority, entry in enumerate(entries, 1):
            if entry.value is not None and entry.source in controllers:
                write = Write(value=None, priority=priority, source=operator)
                bus.ask(keys.WRITE_REQUEST, branch, write, Ack, name=point)


def _simulate(bus: Bus, branch: str, steps: int, future: Future) -> list[Sample]:
    """Simulate a branch with its commands as they are, or with a controller's; return its present and next samples."""
    # Without a controller nothing is commanded, so no actuator is claimed.
    claimed: list[str] | None = [] if future.controller is None else None
    link = open_link(bus, branch, name="what-if", priority=future.priority, actuators=claimed)
    try:
        first = bus.latest(branch)
        steps = min(steps, link.manifest.steps - first.step[0])
        if future.controller is not None:
            return [first, *_controlled(link, first, steps, future.controller(link.manifest))]
        return [first, *_as_it_is(link, first, steps)]
    finally:
        link.close()


def _as_it_is(link: ControllerLink, sample: Sample, steps: int) -> list[Sample]:
    """Simulate timesteps without any new command."""
    actuators = len(link.manifest.actuators)
    samples: list[Sample] = []
    while len(samples) < steps:
        count = min(steps - len(samples), _steps_per_request(link.manifest))
        keep = bytes([CommandOp.KEEP]) * actuators * count, bytes(8 * actuators * count)
        simulated = _plan(link, sample, count, *keep)
        samples += simulated
        if len(simulated) < count:
            break
        sample = samples[-1]
    return samples


def _controlled(link: ControllerLink, sample: Sample, steps: int, agent: Agent) -> list[Sample]:
    """Simulate timesteps with the commands of a controller, which answers each sample."""
    arrays = CommandArrays(link.manifest)
    samples: list[Sample] = []
    while len(samples) < steps:
        values, operations = arrays.of(_answer(agent, link.set_current(sample)), None)
        simulated = _plan(link, sample, 1, operations, values)
        if not simulated:
            break
        samples += simulated
        sample = samples[-1]
    return samples


def _answer(agent: Agent, sample: SampleView) -> Values:
    """Return the commands of a controller for a sample; `InvalidConfig` if it does not answer in time."""
    answer: concurrent.futures.Future[Values] = concurrent.futures.Future()

    def act() -> None:
        try:
            answer.set_result(agent.values(sample))
        except Exception as error:
            answer.set_exception(error)

    threading.Thread(target=act, name="what-if", daemon=True).start()
    concurrent.futures.wait([answer], ANSWER_LIMIT_S)
    if not answer.done():
        name = type(agent.controller).__name__
        raise InvalidConfig(f"{name} did not answer the sample of {sample.time} within {ANSWER_LIMIT_S:g} s")
    return answer.result()


def _plan(
    link: ControllerLink, sample: Sample, timesteps: int, operations: bytes | None, values: bytes
) -> list[Sample]:
    """Simulate timesteps from a branch's sample; return their samples, fewer if the episode ends."""
    plan = SimulatePlan(
        controller=link.name,
        episode=sample.episode,
        step=sample.step,
        timesteps=timesteps,
        operations=operations,
        values=values,
    )
    return [codec.decode(Sample, payload) for payload in link.bus.plan(link.manifest.node, plan).samples]


def _steps_per_request(manifest: Manifest) -> int:
    size = 16 * len(manifest.points) + 24 * len(manifest.actuators) + 4000
    return max(1, min(_STEPS_PER_REQUEST, _REPLY_BYTES // size))


def futures_content(description: NodeDescription, futures: Mapping[str, list[Sample]]) -> dict[str, Any]:
    """Return the episode, begin and times, and for each future the values of all points and the totals.

    Args:
        description: of the node.
        futures: samples by the name of the future, the one at its begin first; see `simulate_futures`.
    """
    manifest = description.manifest
    width, actuators = len(manifest.points), len(manifest.actuators)
    result: dict[str, Any] = {}
    for name, (_, *samples) in futures.items():
        # Faults change what is measured, not what the building uses.
        raw = [sample.fault_free_values or sample.values for sample in samples]
        values = np.stack([codec.floats(each, (width,), "values") for each in raw])
        effective = np.stack([codec.floats(sample.effective, (actuators,), "effective") for sample in samples])
        times = [datetime.fromisoformat(sample.time[0]) for sample in samples]
        result["episode"] = samples[0].episode[0]
        result["begin"] = (times[0] - manifest.timestep).isoformat()
        result["time"] = [time.isoformat() for time in times]
        result[name] = {
            "series": [numbers(column) for column in np.hstack([values, effective]).T],
            "totals": _totals(description, values, times),
        }
    return result


def _totals(description: NodeDescription, values: Floats, times: list[datetime]) -> dict[str, float | None]:
    """Return energy by fuel in kWh, peak power in kW, and K h outside the band, of occupied zones and of all."""
    step_h = description.manifest.step_h
    totals: dict[str, float | None] = {"hours": number(len(values) * step_h)}
    for name, source in (("facility", description.roles.facility_power), ("hvac", description.roles.hvac_power)):
        if source is not None:
            power = values[:, source.index] * source.to_kw
            totals[f"{name}_kwh"] = number(float(power.sum()) * step_h)
            totals[f"{name}_peak_kw"] = number(float(power.max()))
    for meter in description.roles.other_fuels:
        power = values[:, meter.index] * meter.to_kw
        totals[f"{meter.fuel.replace(' ', '_')}_kwh"] = number(float(power.sum()) * step_h)
    comfort = description.comfort
    if comfort is not None:
        begins = [time - timedelta(hours=step_h) for time in times]
        outside = np.stack([comfort.outside(row, begin) for row, begin in zip(values, begins, strict=True)])
        occupied = comfort.is_occupied(values)
        totals["degree_hours"] = number(float(np.nansum(outside * occupied)) * step_h)
        totals["degree_hours_always"] = number(float(np.nansum(outside)) * step_h)
    return totals
