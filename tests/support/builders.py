"""Small things that several tests need: actuators, manifests and exchanges built by hand."""

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.topics import codec
from zenostat.topics.messages import (
    Action,
    Actuator,
    Aggregation,
    Claim,
    Command,
    CommandOp,
    Event,
    Manifest,
    Meter,
    Mode,
    Policy,
    Sample,
    Sensor,
    Task,
    Versions,
)
from zenostat.topics.points import value_index

NAN = float("nan")
NOON = datetime(2017, 1, 16, 12)


def actuator(name: str, low: float | None = None, high: float | None = None) -> Actuator:
    """A setpoint in degC."""
    return Actuator(
        name=name, component_type="Schedule:Compact", control_type="Schedule Value", key=name, unit="degC",
        low=low, high=high,
    )  # fmt: skip


def sensor(name: str, variable: str = "Zone Air Temperature", key: str = "", unit: str = "degC") -> Sensor:
    """A sensor of the state of something."""
    return Sensor(name=name, variable=variable, key=key or name, unit=unit, aggregation=Aggregation.INSTANT)


def meter(name: str, energyplus: str = "Electricity:Facility") -> Meter:
    """A meter in joules."""
    return Meter(name=name, meter=energyplus, unit="J", low=0.0)


def own_action(of: Actuator) -> Action:
    """The action that sets this actuator alone, within its bounds."""
    return Action(name=of.name, unit=of.unit, low=of.low, high=of.high, actuators=(of.name,))


def manifest(
    *,
    sensors: Sequence[Sensor] = (),
    meters: Sequence[Meter] = (),
    actuators: Sequence[Actuator] = (),
    slots: int = 1,
    task: Task | None = None,
) -> Manifest:
    """One day in steps of a quarter of an hour; without a `task` each actuator has an action of its own."""
    return Manifest(
        node="office",
        instance="1f",
        building="office-small",
        weather="USA_CO_Denver",
        location="Denver",
        begin="2017-07-01T00:00:00",
        end="2017-07-02T00:00:00",
        step_s=900.0,
        steps=96,
        slots=slots,
        mode=Mode.LOCKSTEP,
        policy=Policy.WAIT,
        sensors=tuple(sensors),
        meters=tuple(meters),
        actuators=tuple(actuators),
        task=Task(actions=tuple(own_action(a) for a in actuators)) if task is None else task,
        versions=Versions(zenostat="0", energyplus="0"),
    )


def exchange(*actuators: Actuator, mode: Mode = Mode.LOCKSTEP, slots: int = 1) -> StepExchange:
    """An exchange that waits at sample 0; by default with a heating and a cooling setpoint."""
    built = StepExchange(
        actuators or (actuator("heat", 15.0, 22.5), actuator("cool", 22.5, 30.0)), slots=slots, mode=mode
    )
    built.ready(0.0)
    return built


def claim(
    at: StepExchange,
    controller: str,
    priority: int = 10,
    *,
    actuators: list[str] | None = None,
    required: bool = True,
    now_s: float = 0.0,
) -> list[Event]:
    """A controller claims actuators."""
    return at.claim(Claim(controller=controller, priority=priority, actuators=actuators, required=required), now_s)


def command(
    values: Sequence[float],
    *,
    step: int | Sequence[int | None] = 0,
    episode: int | Sequence[int] = 0,
    operations: Sequence[CommandOp] | None = None,
) -> Command:
    """A command of slot 0, or of all slots where `step` and `episode` are lists."""
    return Command(
        episode=[episode] if isinstance(episode, int) else list(episode),
        step=[step] if isinstance(step, int) else list(step),
        operations=None if operations is None else bytes(operations),
        values=np.array(values, "<f8").tobytes(),
    )


def answer(
    at: StepExchange,
    controller: str,
    values: Sequence[float],
    operations: Sequence[CommandOp] | None = None,
    *,
    now_s: float = 0.0,
) -> Event | None:
    """The controller answers the present sample."""
    return at.intake.command(
        controller, command(values, step=at.step, episode=at.episode, operations=operations), now_s
    )


def advance(at: StepExchange, *, last: bool = False, now_s: float = 0.0) -> tuple[list[float], list[str]]:
    """One timestep: the values that ruled it (NaN: the building's own) and who set them."""
    assert at.ready_to_step(), f"waits for {at.awaiting()}"
    values = at.begin_step(now_s)
    at.finish_step([last] * len(at.active_slots), now_s)
    sources = [at.source_names[i] for i in np.frombuffer(at.source_index, "<u2")]
    return np.frombuffer(values, "<f8").tolist(), sources


def ruling(at: StepExchange) -> tuple[list[float], list[str]]:
    """Return the values and sources of the next timestep, without simulating it: on a copy."""
    import copy

    ahead = copy.deepcopy(at)
    values = ahead.begin_step(0.0)
    sources = [ahead.source_names[i] for i in np.frombuffer(ahead.source_index, "<u2")]
    return np.frombuffer(values, "<f8").tolist(), sources


def wire(of: Command) -> bytes:
    """A command's bytes."""
    return codec.encode(of)


def view(of: Manifest, at: datetime = NOON, *, step: int = 0, episode: int = 0, **values: float) -> SampleView:
    """A sample with these values by name, and 21 for all others."""
    row = np.array([values.get(name, 21.0) for name in of.names], "<f8")
    wire = Sample(
        episode=[episode],
        step=[step],
        time=[at.isoformat()],
        elapsed_s=[0.0],
        flags=[0],
        values=row.tobytes(),
        effective=np.full(len(of.actuators), np.nan).tobytes(),
        source_index=bytes(2 * len(of.actuators)),
        sources=[""],
    )
    return SampleView(wire, of, value_index(of))
