"""The orchestration of a step: plants in topological order, and loops solved by trials.

Plants without a loop step in the order of their connections, so that each has the values of this same step
(Gauss-Seidel); those that do not depend on each other step at the same time. A delayed connection has the values of an
earlier step. In a loop, the values of the solved connections are the unknowns: each trial steps copies of the loop's
plants in order, and the residual is what comes back less what was assumed. The trial with the least residual is then
committed: the plants themselves step with its commands, and have its values to the bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from math import fsum, isfinite, nan
from typing import Any, TypeVar

import numpy as np

from zenostat.cosim.balance import Ledger
from zenostat.cosim.binding import Binding, Input, Transfer
from zenostat.cosim.coupled import GuardedPlant, Rows
from zenostat.cosim.file import SolverSpec
from zenostat.cosim.market import Bids, Clearing, Demand, LinearBids, clear
from zenostat.cosim.market_plant import PRICE, SENSORS, Market, MarketPlant
from zenostat.cosim.solver import Outcome, Problem, Secants, Solution, solve
from zenostat.cosim.topology import Block
from zenostat.topics.arrays import Floats
from zenostat.topics.connection_balance import ConnectionBalance

_Result = TypeVar("_Result")

_REASONS = {
    Outcome.JUMP: "the plants respond with a jump",
    Outcome.LIMIT: "the limit was reached",
    Outcome.UNDEFINED: "a plant has no value",
}

_STATE = ("rows", "loops", "_flows", "_ledgers", "_orders", "_step", "_clearings", "_demands", "_silent", "_overridden")
"""Attributes of the orchestrator that change from step to step: mappings, lists of what has `copy`, and a number."""


@dataclass(slots=True)
class LoopState:
    """The latest result of a loop.

    Attributes:
        trials: number of trials of the step.
        error: largest ratio of a residual to its tolerance.
        is_solved: whether it is within the tolerances.
        unsolved: number of steps of the episode that were not solved.
        total: number of trials of the episode.
        steps: number of its steps.
        secants: of the latest solution, with which the next one begins.
    """

    trials: int = 0
    error: float = 0.0
    is_solved: bool = True
    unsolved: int = 0
    total: int = 0
    steps: int = 0
    secants: Secants = ()

    def copy(self) -> LoopState:
        """Return a state that changes on its own."""
        return replace(self)


@dataclass(slots=True)
class _Flow:
    """The state of a connection.

    Attributes:
        store: converted values of the latest steps that a delay holds, the oldest first.
        previous: converted value of the source's latest timestep.
        last: latest converted value of the source that is a finite number, which holds where it has none; else NaN.
        is_missing: whether the source had no value in a timestep of the latest step.
        received: values that the target got in the latest step, shape (target's timesteps,).
        unknown: those of a solved connection, with which the next step begins.
        residual: of the latest step, shape (target's timesteps,).
        terms: those of the balance of the latest step, means over the step in the target's unit.
    """

    ledger: Ledger
    store: deque[Floats] = field(default_factory=deque)
    previous: float = 0.0
    last: float = nan
    is_missing: bool = False
    received: Floats = field(default_factory=lambda: np.zeros(1))
    unknown: Floats = field(default_factory=lambda: np.zeros(1))
    residual: Floats = field(default_factory=lambda: np.zeros(1))
    terms: dict[str, float] = field(default_factory=dict)

    def copy(self) -> _Flow:
        """Return a flow that changes on its own."""
        return replace(self, ledger=self.ledger.copy(), store=self.store.copy())


class Orchestrator:
    """Steps the plants of a district.

    Args:
        binding: plants, connections and order.
        plants: the plants by name.
        solver: limits of the solver.

    Attributes:
        rows: samples of the latest step of each plant.
        loops: state of each loop, in the order of `binding.topology.loops`.
        inputs: values that each input got in the latest step, the mean over its timesteps, as `binding.inputs`.
    """

    def __init__(self, binding: Binding, plants: Mapping[str, GuardedPlant], solver: SolverSpec) -> None:
        self._binding, self._plants, self._solver = binding, plants, solver
        self._transfers = binding.transfers
        entries = [transfer.entry for transfer in self._transfers]
        self._same_value = [[i for i, other in enumerate(entries) if other == entry] for entry in entries]
        self._by_plant: dict[str, list[Input]] = {name: [] for name in binding.members}
        for target in binding.inputs:
            self._by_plant[target.plant].append(target)
        self.rows: dict[str, Rows] = {}
        self.loops = [LoopState() for _ in binding.topology.loops]
        self._flows: list[_Flow] = []
        self._ledgers: list[Ledger] = []
        self._orders: dict[str, Floats] = {}
        self._warnings: list[str] = []
        self._step = 0
        self._clearings: dict[str, Clearing] = {}
        self._demands: dict[str, Floats] = {}
        self._silent: dict[str, frozenset[str]] = {}
        self._overridden = frozenset[str]()

    # Episodes

    def start(self, seeds: Mapping[str, int]) -> None:
        """Begin an episode of all plants; raises what `GuardedPlant.reset` does."""
        self._step = 0
        self.rows = {name: plant.reset(seeds[name]) for name, plant in self._plants.items()}
        self.loops = [LoopState() for _ in self.loops]
        self._flows = [self._initial(transfer) for transfer in self._transfers]
        self._ledgers = [Ledger(f"{i.plant}.{i.actuator.name}", i.actuator.unit) for i in self._binding.inputs]
        self._silent, self._overridden = {}, frozenset()
        demands = {name: _demands(market, self.rows) for name, market in self._binding.markets.items()}
        self._demands = {name: np.where(np.isfinite(watts), watts, 0.0) for name, watts in demands.items()}

    def _initial(self, transfer: Transfer) -> _Flow:
        """Return the state of a connection at sample 0."""
        value = transfer.convert(self.rows[transfer.source].values[-1:, transfer.column])
        first = value if transfer.initial is None else np.array([transfer.initial])
        last = next((each for each in (float(value[0]), float(first[0])) if isfinite(each)), nan)
        previous = first if transfer.delay else value  # before the first values that arrive
        flow = _Flow(Ledger(transfer.name, transfer.unit), previous=float(previous[0]), last=last)
        flow.store.extend([np.repeat(first, transfer.source_steps)] * transfer.delay)
        flow.unknown = np.repeat(transfer.clip(first), transfer.target_steps)
        flow.received, flow.residual = flow.unknown, np.zeros(transfer.target_steps)
        flow.terms = dict.fromkeys(transfer.balance_terms, 0.0) | {"sent": float(value[0])}
        return flow

    def capture(self) -> dict[str, Any]:
        """Return a copy of the state at the present sample."""
        return _copied({name: getattr(self, name) for name in _STATE})

    def adopt(self, state: Mapping[str, Any]) -> None:
        """Continue from a state that `capture` returned, which remains as it is."""
        for name, value in _copied(state).items():
            setattr(self, name, value)

    # A step

    def step(self, commands: Mapping[str, Floats]) -> None:
        """Simulate a step of the district.

        Args:
            commands: of the actuators of each plant, shape (actuators,), NaN where relinquished; those that
                connections feed are ignored.

        Raises:
            SimulatorError: a plant is lost, or cannot be copied for a solved loop.
        """
        for _ in self.parts(commands):
            pass

    def parts(self, commands: Mapping[str, Floats]) -> Iterator[None]:
        """Simulate a step as `step` does, in parts.

        Yields:
            Nothing, when plants have begun for which the next part waits; other runs may begin theirs then.
        """
        self._step += 1
        done: dict[str, Rows] = {}
        loops, solved = iter(range(len(self.loops))), list[tuple[Block, int, Solution]]()
        for group in self._binding.topology.groups:
            single = [block.plants[0] for block in group if not block.solved]
            for name in single:
                self._begin(name, commands, done)
                if name in self._binding.markets:
                    self._clear(self._binding.markets[name], commands, done)
            yield
            solved += self._solve_all([(block, next(loops)) for block in group if block.solved], commands, done)
            for name in single:
                done[name] = self._plants[name].finish()
        for name, market in self._binding.markets.items():
            demands = self._demands[name] = self._settled_demands(market, done)
            done[name] = self._market(name).settle(self._clearings[name], float(demands.sum()))
        self.rows = done
        for transfer, flow in zip(self._transfers, self._flows, strict=True):
            self._settle(transfer, flow)
        for block, number, solution in solved:
            self._report(block, self.loops[number], solution)
        for target, ledger in zip(self._binding.inputs, self._ledgers, strict=True):
            self._settle_input(target, ledger)
        self._warn_of_overridden()

    def _begin(self, plant: str, own: Mapping[str, Floats], done: Mapping[str, Rows]) -> None:
        self._orders[plant] = self._commands(plant, own, done)
        self._plants[plant].begin(self._orders[plant])

    def _commands(self, plant: str, own: Mapping[str, Floats], done: Mapping[str, Rows]) -> Floats:
        """Return the commands of a plant for its timesteps; sets what its connections received."""
        rows = np.tile(own[plant], (self._binding.members[plant].steps, 1))
        for target in self._by_plant[plant]:
            first, *others = (self._received(position, done) for position in target.transfers)
            rows[:, target.column] = np.minimum(np.maximum(sum(others, start=first), target.low), target.high)
        return rows

    def _received(self, position: int, done: Mapping[str, Rows]) -> Floats:
        """Return the values that a connection brings in this step."""
        transfer, flow = self._transfers[position], self._flows[position]
        if transfer.tolerance is not None:
            flow.received = flow.unknown
        elif transfer.delay:
            flow.received = transfer.clip(transfer.resample(flow.store[0], flow.previous))
        else:
            flow.received = self._carried(position, done[transfer.source].values)
        return flow.received

    def _carried(self, position: int, values: Floats) -> Floats:
        """Return the values of a source in the target's unit, timesteps and bounds."""
        transfer, flow = self._transfers[position], self._flows[position]
        converted = _with_last(transfer.convert(values[:, transfer.column]), flow.last)
        return transfer.clip(transfer.resample(converted, flow.previous))

    # Markets

    def _market(self, name: str) -> MarketPlant:
        plant = self._plants[name].plant
        assert isinstance(plant, MarketPlant)
        return plant

    def _clear(self, market: Market, own: Mapping[str, Floats], done: Mapping[str, Rows]) -> None:
        """Find the price of a step, which the plants after it get."""
        plant, spec = self._market(market.name), market.spec
        if spec.bids is Bids.LINEAR:
            slopes = np.array([bidder.slope_w for bidder in spec.bidders])
            price = float(self.rows[market.name].values[-1, PRICE])
            demand: Demand = LinearBids(slopes, price, self._demands[market.name])
        else:
            demand = partial(self._bids, market, own, done)
        clearing = self._unless_lost(market.plants, lambda: clear(demand, spec, plant.limit_w))
        self._clearings[market.name] = clearing
        plant.settle(clearing, clearing.demand_w)
        if not clearing.is_cleared:
            self._warnings.append(
                f"market {market.name!r} does not clear in step {self._step}: at the highest price {clearing.price:g}, "
                f"{clearing.demand_w:.6g} W are asked for, and {plant.limit_w:g} W are the limit"
            )

    def _bids(self, market: Market, own: Mapping[str, Floats], done: Mapping[str, Rows], prices: Floats) -> Floats:
        """Return the sum of what the bidders would draw at several prices, W: one request for trials to each."""
        settled = [dict(done) for _ in prices]
        for rows, price in zip(settled, prices.tolist(), strict=True):
            row = np.zeros((1, len(SENSORS)))
            row[0, PRICE] = price
            rows[market.name] = Rows(row, np.empty((1, 0)))
        tried: list[dict[str, Rows]] = [{} for _ in prices]
        bidders = [*dict.fromkeys(market.plants)]
        for name in bidders:
            self._plants[name].begin_trial([self._commands(name, own, rows) for rows in settled])
        for name in bidders:
            for values, sample in zip(tried, self._plants[name].finish_trial(), strict=True):
                values[name] = sample
        return np.array([self._with_last_demands(market, _demands(market, rows)).sum() for rows in tried])

    def _with_last_demands(self, market: Market, demands: Floats) -> Floats:
        """Return the demand of each bidder in W; of one without a value the last one."""
        return np.where(np.isfinite(demands), demands, self._demands[market.name])

    def _settled_demands(self, market: Market, rows: Mapping[str, Rows]) -> Floats:
        """Return the demands of a step; an event names a bidder that begins to have no value."""
        demands = _demands(market, rows)
        silent = {bidder.demand for bidder, w in zip(market.spec.bidders, demands, strict=True) if not isfinite(w)}
        self._warnings += [
            f"market {market.name!r}: its bidder {point!r} has no value in step {self._step}; the last one holds until "
            "it has one"
            for point in sorted(silent - self._silent.get(market.name, frozenset()))
        ]
        self._silent[market.name] = frozenset(silent)
        return self._with_last_demands(market, demands)

    # Loops

    def _solve_all(
        self, loops: Sequence[tuple[Block, int]], own: Mapping[str, Floats], done: dict[str, Rows]
    ) -> list[tuple[Block, int, Solution]]:
        """Solve loops that do not depend on each other, at the same time, and step their plants."""
        if len(loops) < 2:
            solved = [self._solve(block, number, own, done) for block, number in loops]
        else:
            with ThreadPoolExecutor(len(loops)) as pool:  # each thread has the plants of one loop
                running = [pool.submit(self._solve, block, number, own, done) for block, number in loops]
            solved = [future.result() for future in running]
        for _, rows in solved:
            done |= rows
        return [(*loop, solution) for loop, (solution, _) in zip(loops, solved, strict=True)]

    def _solve(
        self, block: Block, number: int, own: Mapping[str, Floats], before: Mapping[str, Rows]
    ) -> tuple[Solution, dict[str, Rows]]:
        """Find the values of the solved connections of a loop, and step its plants with them; return their samples."""
        done = dict(before)
        sizes = [self._transfers[position].target_steps for position in block.solved]
        cuts = np.cumsum(sizes)[:-1]
        inner = [t for t in self._transfers if not t.delay and {t.source, t.target} <= set(block.plants)]

        def assume(unknowns: Floats) -> None:
            for position, part in zip(block.solved, np.split(unknowns, cuts), strict=True):
                for other in self._same_value[position]:
                    self._flows[other].unknown = part

        def evaluate(unknowns: Floats) -> Floats:
            assume(unknowns)
            tried = dict(done)
            for level in block.levels:
                self._try(level, own, tried)
            if not all(np.isfinite(tried[t.source].values[:, t.column]).all() for t in inner):
                return np.full_like(unknowns, np.nan)
            returned = [self._carried(p, tried[self._transfers[p].source].values) for p in block.solved]
            return np.concatenate(returned)

        start = np.concatenate([self._flows[position].unknown for position in block.solved])
        solution = self._unless_lost(
            block.plants, lambda: self._search(block, evaluate, start, self.loops[number].secants)
        )
        assume(solution.best.x)
        for level in block.levels:
            for name in level:
                self._begin(name, own, done)
            for name in level:
                done[name] = self._plants[name].finish()
        return solution, {name: done[name] for name in block.plants}

    def _try(self, level: Sequence[str], own: Mapping[str, Floats], done: dict[str, Rows]) -> None:
        """Try the step of plants that can run side by side."""
        for name in level:
            self._plants[name].begin_trial([self._commands(name, own, done)])
        for name in level:
            (done[name],) = self._plants[name].finish_trial()

    def _unless_lost(self, names: Sequence[str], trials: Callable[[], _Result]) -> _Result:
        """Return the result of trials of plants; once more if one was lost, so that all are with its last values."""
        while True:
            before = [self._plants[name].is_available for name in names]
            result = trials()
            if before == [self._plants[name].is_available for name in names]:
                return result

    def _search(self, block: Block, evaluate: Callable[[Floats], Floats], start: Floats, secants: Secants) -> Solution:
        transfers = [self._transfers[position] for position in block.solved]

        def of_each(values: Sequence[float]) -> Floats:
            return np.repeat(np.array(values), [transfer.target_steps for transfer in transfers])

        problem = Problem(
            evaluate,
            tolerance=of_each([transfer.tolerance or 0.0 for transfer in transfers]),
            low=of_each([transfer.low for transfer in transfers]),
            high=of_each([transfer.high for transfer in transfers]),
            limit=self._solver.trials,
        )
        return solve(problem, start, depth=self._solver.depth, damping=self._solver.damping, secants=secants)

    def _report(self, block: Block, state: LoopState, solution: Solution) -> None:
        """Note the result of a loop; its plants may have stepped otherwise than in its best trial, if one was lost."""
        error = self._committed_error(block) if solution.is_solved else solution.best.error
        state.trials, state.error, state.is_solved = solution.trials, error, solution.is_solved and error <= 1.0
        state.secants = solution.secants if state.is_solved else ()
        state.total += solution.trials
        state.steps += 1
        if state.is_solved:
            return
        state.unsolved += 1
        residual = f"; its residual is {error:.3g} times the tolerance" if isfinite(error) else ""
        if solution.bracket is not None:
            low, high = solution.bracket
            unit = self._transfers[block.solved[0]].unit
            residual += f", and it changes its sign between {low:.9g} and {high:.9g} {unit}"
        reason = "a plant did not step as in its trial" if solution.is_solved else _REASONS[solution.outcome]
        self._warnings.append(
            f"loop {block.name!r} is not solved in step {self._step} after {solution.trials} trials, since "
            f"{reason}{residual}"
        )

    def _committed_error(self, block: Block) -> float:
        """Return the largest ratio of a loop's residual in the step to its tolerance; NaN where there is none."""
        flows = [(self._flows[position], self._transfers[position].tolerance or 0.0) for position in block.solved]
        return float(np.max([np.max(np.abs(flow.residual) / tolerance) for flow, tolerance in flows]))

    # Balances

    def _settle(self, transfer: Transfer, flow: _Flow) -> None:
        """Enter the exchange of a step into the balance of a connection."""
        converted = self._held(transfer, flow)
        current = converted
        if transfer.delay:
            current = flow.store.popleft()
            flow.store.append(converted)
        resampled = transfer.resample(current, flow.previous)
        clipped = transfer.clip(resampled)
        flow.previous = float(current[-1])
        flow.residual = clipped - flow.received
        if transfer.tolerance is not None and not np.isfinite(flow.unknown).all():
            flow.unknown = clipped
        values = (converted, current, resampled, clipped, flow.received)
        if flow.is_missing or not all(np.isfinite(each).all() for each in values):
            flow.ledger.missing_steps += 1
            flow.residual = np.full_like(flow.residual, nan)
            flow.terms = dict.fromkeys(flow.terms, nan)
            return
        flow.ledger.enter(values, transfer.source_step_s, transfer.target_step_s)
        sent, kept, carried, limited, got = map(_mean, values)
        flow.terms = {
            "sent": sent,
            "clipped": carried - limited,
            "resampled": kept - carried,
            "residual": limited - got,
            "stored": sent - kept,
        }

    def _held(self, transfer: Transfer, flow: _Flow) -> Floats:
        """Return the values of a source in the target's unit; where it has none, the last one holds."""
        own = transfer.convert(self.rows[transfer.source].values[:, transfer.column])
        is_missing = not np.isfinite(own).all()
        if is_missing and not flow.is_missing:
            holds = "the last one holds" if isfinite(flow.last) else "the actuator is relinquished"
            self._warnings.append(
                f"connection {transfer.name!r}: its source has no value in step {self._step}; {holds} until it has one"
            )
        held = _with_last(own, flow.last)
        flow.is_missing, flow.last = is_missing, float(held[-1])
        return held

    def _settle_input(self, target: Input, ledger: Ledger) -> None:
        """Enter what an input got in a step: the values of its connections, and what it was commanded to."""
        step_s = self._binding.members[target.plant].step_s
        if not np.isfinite(self._orders[target.plant][:, target.column]).all():
            ledger.missing_steps += 1
            return
        for position in target.transfers:
            for value in self._flows[position].received.tolist():
                ledger.sent.add(value * step_s)
                ledger.greatest.add(abs(value) * step_s)
                ledger.clipped.add(value * step_s)
        for value in self._orders[target.plant][:, target.column].tolist():
            ledger.received.add(value * step_s)
            ledger.clipped.add(-value * step_s)

    def _warn_of_overridden(self) -> None:
        """Add an event for each input that begins to have another value than that of its connections."""
        present = {}
        for target in self._binding.inputs:
            ordered = self._orders[target.plant][:, target.column]
            effective = self.rows[target.plant].effective[:, target.column]
            others = effective[np.isfinite(effective) & np.isfinite(ordered) & (effective != ordered)]
            if len(others) and self._plants[target.plant].is_available:
                present[f"{target.plant}.{target.actuator.name}"] = float(others[-1])
        self._warnings += [
            f"actuator {name!r} has the value {value:g} in step {self._step} and not that of its connection, which the "
            "balance has"
            for name, value in present.items()
            if name not in self._overridden
        ]
        self._overridden = frozenset(present)

    @property
    def received(self) -> Floats:
        """Value that each connection brought in the latest step, the mean over the target's timesteps."""
        return np.array([_mean(flow.received) for flow in self._flows])

    @property
    def residuals(self) -> Floats:
        """Residual of each connection in the latest step, of the greatest absolute value; 0 if it is not solved."""
        return np.array([float(flow.residual[np.argmax(np.abs(flow.residual))]) for flow in self._flows])

    @property
    def balance_terms(self) -> list[float]:
        """Terms of the balances of the latest step, of each connection those of `Transfer.balance_terms`."""
        pairs = zip(self._transfers, self._flows, strict=True)
        return [flow.terms[name] for transfer, flow in pairs for name in transfer.balance_terms]

    def balances(self) -> list[ConnectionBalance]:
        """Return the balance of each connection since sample 0, then of each input that adds several."""
        several = [
            ledger for i, ledger in zip(self._binding.inputs, self._ledgers, strict=True) if len(i.transfers) > 1
        ]
        return [ledger.balance() for ledger in (*(flow.ledger for flow in self._flows), *several)]

    def drain_warnings(self) -> list[str]:
        """Return texts about plants and loops since the last call."""
        warnings, self._warnings = self._warnings, []
        return [*(text for plant in self._plants.values() for text in plant.drain_warnings()), *warnings]


def _copied(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return a state that further steps do not change; arrays are shared, since each step makes new ones."""
    return {
        name: dict(value)
        if isinstance(value, dict)
        else [each.copy() for each in value]
        if isinstance(value, list)
        else value
        for name, value in state.items()
    }


def _demands(market: Market, rows: Mapping[str, Rows]) -> Floats:
    """Return the demand of each bidder in W; NaN where it has no value."""
    return market.demands({name: rows[name].values for name in market.plants})


def _with_last(values: Floats, last: float) -> Floats:
    """Return values in which the last finite number holds in place of what is none; at first that is `last`."""
    if np.isfinite(values).all():
        return values
    held = []
    for value in values.tolist():
        last = value if isfinite(value) else last
        held.append(last)
    return np.array(held)


def _mean(values: Floats) -> float:
    return fsum(values.tolist()) / len(values)
