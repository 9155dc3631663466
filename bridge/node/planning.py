"""Plans: several timesteps of a branch, with a command for each of them, simulated by one request.

The step exchange decides each timestep of a plan as if its command had arrived alone: claims, bounds, priorities and
expiries are the same. Only the plant is faster, because its simulators have the commands of the next timesteps before
all of them have finished the present one. Requests and writes that arrive during a plan wait for its end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import monotonic

from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.node.plant import PlanningPlant, RunningPlant
from zenostat.bridge.node.sample_encoding import SampleHead
from zenostat.bridge.node.served_node import ServedNode
from zenostat.topics import codec, errors
from zenostat.topics.errors import BadMessage, PlantFailed, RequestRejected, SimulatorError
from zenostat.topics.messages import Command, Event, Mode, PlanSimulated, SimulatePlan, State, TrySteps


class PlanSimulation:
    """Simulates the plans of one node server, in its thread."""

    def __init__(self, server: ServedNode) -> None:
        self._server = server

    def simulate(self, plan: SimulatePlan) -> PlanSimulated:
        """Simulate a plan, at most until all episodes end, and publish the last sample.

        Raises:
            RequestRejected: the node is not a branch in lockstep, another controller has to answer as well, or a
                command is not valid; nothing was simulated.
            SimulatorError: the plant failed.
        """
        server, exchange = self._server, self._server.exchange
        self._check(plan)
        pending = self._commands(plan)
        samples: list[bytes] = []
        while pending and exchange.state is State.WAITING:
            length = 1 if server.injection is not None else min(len(pending), steps_left(server))
            if length == 1:
                samples.append(self._step(plan.controller, pending[0]))
            else:
                samples += self._run(plan.controller, pending[:length])
            del pending[:length]
        return PlanSimulated(samples=samples)

    def _check(self, plan: SimulatePlan) -> None:
        server, exchange = self._server, self._server.exchange
        if not server.manifest.branch_of:
            raise RequestRejected("only a branch simulates a plan; create one with rpc/branch")
        if exchange.mode is not Mode.LOCKSTEP or server.pacing.paused:
            raise RequestRejected("a plan needs a branch in lockstep that is not paused")
        holder = exchange.claims.by_name.get(plan.controller)
        if holder is None or not holder.required:
            raise RequestRejected(f"{plan.controller!r} has no required claim; claim first")
        if exchange.state is not State.WAITING:
            raise RequestRejected("the episode is over" if exchange.state is State.ENDED else "the branch has failed")
        if exchange.awaiting() != [plan.controller]:
            others = [name for name in exchange.awaiting() if name != plan.controller]
            raise RequestRejected(
                f"a plan has the commands of one controller, and {', '.join(others)} has to answer as well"
                if others
                else f"step {exchange.step} is already answered"
            )
        if plan.episode != exchange.episode or plan.step != exchange.step:
            raise RequestRejected(
                f"it answers episode {plan.episode} step {plan.step}; the current ones are episode "
                f"{exchange.episode} step {exchange.step}"
            )
        largest = codec.MAX_BYTES // (len(server.latest_sample) + 16)
        if plan.timesteps > largest:
            raise RequestRejected(f"{plan.timesteps} timesteps; the reply has room for {largest} samples")

    def _commands(self, plan: SimulatePlan) -> list[tuple[bytes, bytes | None]]:
        """Return values and operations of each timestep; `RequestRejected` if the exchange would not accept one."""
        exchange = self._server.exchange
        commands = split_commands(plan, plan.timesteps, exchange.commands.size)
        holder = exchange.claims.by_name[plan.controller]
        for number, command in enumerate(commands):
            try:
                exchange.commands.check(holder, self._command(*command))
            except BadMessage as error:
                raise RequestRejected(f"timestep {number} of the plan: {error}") from None
        return commands

    def _command(self, values: bytes, operations: bytes | None) -> Command:
        exchange = self._server.exchange
        step = [None if done else step for step, done in zip(exchange.step, exchange.done, strict=True)]
        return Command(episode=exchange.episode, step=step, operations=operations, values=values)

    def _accept(self, controller: str, command: tuple[bytes, bytes | None]) -> None:
        event: Event | None = self._server.exchange.intake.command(controller, self._command(*command), monotonic())
        if event is not None:
            self._server.event(event)
        if not self._server.exchange.ready_to_step():
            raise RequestRejected(event.text if event is not None else "the command was not accepted")

    def _step(self, controller: str, command: tuple[bytes, bytes | None]) -> bytes:
        server = self._server
        self._accept(controller, command)
        server.step()
        if server.exchange.state is State.FAILED:
            raise errors.from_wire({"error": server.failure_error, "message": server.failure})
        return server.latest_sample

    def _run(self, controller: str, plan: Sequence[tuple[bytes, bytes | None]]) -> list[bytes]:
        """Simulate timesteps of which only the last one can end an episode."""
        server, exchange = self._server, self._server.exchange
        orders: list[bytes] = []
        heads: list[SampleHead] = []
        for command in plan:
            if orders:
                exchange.finish_step([False] * len(exchange.active_slots), monotonic())
                heads.append(SampleHead.of(exchange))
            self._accept(controller, command)
            if exchange.commands.has_expiries:
                server.publish_events(exchange.intake.expire(server.elapsed_s))
            orders.append(exchange.begin_step(monotonic()))
        samples: list[bytes] = []
        try:
            for number, last in enumerate(simulate(server.plant, orders, exchange.active_slots)):
                if number < len(heads):
                    if any(last):
                        raise PlantFailed(f"the plant ended before the {len(plan)} timesteps of its run period")
                    samples.append(server.samples.encode(heads[number], server.plant.values()))
                else:
                    exchange.finish_step(last, monotonic())
        except SimulatorError as error:
            server.fail(error)
            raise
        server.finish_steps(orders[-1])
        return [*samples, server.latest_sample]


def require_episodes(exchange: StepExchange, verb: str) -> None:
    """Raise `RequestRejected`, which says that there is nothing to `verb`, unless all slots are in an episode."""
    if exchange.state is not State.WAITING or any(exchange.done):
        state = exchange.state if exchange.state in (State.STARTING, State.FAILED) else "over"
        over = [str(slot) for slot, done in enumerate(exchange.done) if done]
        of = f" of slot {', '.join(over)}" if state == "over" and len(over) < len(exchange.done) else ""
        raise RequestRejected(f"there is nothing to {verb}: the episode{of} is {state}; reset it first")


def steps_left(server: ServedNode) -> int:
    """Return the number of timesteps until the first of the running episodes ends."""
    exchange = server.exchange
    running = [step for step, done in zip(exchange.step, exchange.done, strict=True) if not done]
    return server.plant.description.run_period.steps - max(running)


def split_commands(request: SimulatePlan | TrySteps, count: int, size: int) -> list[tuple[bytes, bytes | None]]:
    """Return values, of `size` bytes, and operations of each command; `RequestRejected` if these are not `count`."""
    values, codes, width = request.values, request.operations, size // 8
    for name, raw, length in (("values", values, size), ("operations", codes, width)):
        if raw is not None and len(raw) != count * length:
            raise RequestRejected(f"{name} has {len(raw)} bytes; {count * length} expected: {count} x {length}")
    return [
        (values[i * size : (i + 1) * size], None if codes is None else codes[i * width : (i + 1) * width])
        for i in range(count)
    ]


def simulate(plant: RunningPlant, orders: Sequence[bytes], active_slots: Sequence[int]) -> Iterator[list[bool]]:
    """Simulate several timesteps at once, if the plant can; see `PlanningPlant.run`."""
    if isinstance(plant, PlanningPlant):
        yield from plant.run(orders, active_slots)
        return
    for order in orders:
        yield plant.step(order, active_slots)
