"""Episode metrics and controller comparison on the same weather."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium as gym
from typing_extensions import override

from zenostat.agent_sdk.controllers import (
    Agent,
    BaselineController,
    ControllerProtocol,
    load_controller,
    make_controller,
)
from zenostat.agent_sdk.controllers.agent import InexpressibleCommands
from zenostat.agent_sdk.controllers.base import PlanningController
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch
from zenostat.agent_sdk.envs.arguments import fields_of_file, of_scenario
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.rewards import Reward
from zenostat.agent_sdk.wrappers.names import layers
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.faults import read_plan
from zenostat.bridge.runtime.user_code import describe_user_error, refuse_exit
from zenostat.lab.scenario_context import context_wrappers, within_context
from zenostat.lab.scenario_env import add_monitoring
from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator
from zenostat.metrics.episode_weather import EpisodeWeather, query_weather
from zenostat.metrics.fuel_rates import Rate, read_emissions, read_prices
from zenostat.metrics.statistics import MetricSummary, summarize
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, UsageError, ZenostatError, did_you_mean, repeated
from zenostat.topics.keys import safe_name
from zenostat.topics.messages import Event, EventKind, State
from zenostat.topics.printable import replace_controls
from zenostat.topics.recording import SUFFIX

if TYPE_CHECKING:
    from zenostat.views.report import Comparison

ControllerFactory = Callable[..., ControllerProtocol]
"""Function of a node's manifest and parameters by name: a controller class, or the result of `load_policy`."""

_ADDED_SENSOR = re.compile(r"_next(_\d+)?$")
"""Name of a sensor of the next value of a schedule, which relative actions add."""

_MOST_WARNINGS = 20
_EVENT_S = 5.0

_OF_ACTIONS = ("relative", "unobserved")

Progress = Callable[[str, int, int, int], None]
"""Callback for each timestep: controller name, episode number, step, steps per episode."""


class SampleRecorder(Protocol):
    """Anything that receives the samples of an episode."""

    def add(self, sample: SampleView, terms: Mapping[str, float] | None = None) -> None:
        """Add a sample with the terms of the reward of the timestep that it closes; sample 0 comes without terms."""


def run_episode(
    env: gym.Env[Any, Any],
    act: Callable[[Any], Any],
    *,
    seed: int | None,
    progress: Callable[[int], None] | None = None,
    recorder: SampleRecorder | None = None,
    prices: Mapping[str, Rate] | None = None,
    emissions: Mapping[str, Rate] | None = None,
) -> tuple[EpisodeMetrics, str]:
    """Run one episode, and return its metrics and the name of its weather.

    Args:
        env: a `BuildingEnv`, wrapped or not. Metrics use the samples and rewards of all timesteps of the `BuildingEnv`,
            also of those for which a wrapper repeats an action.
        act: function from observation to action.
        seed: seed for `reset`.
        progress: callback for each timestep, with the step.
        recorder: records the samples and the terms of the rewards.
        prices: as for `evaluate`.
        emissions: as for `evaluate`.

    Raises:
        InvalidConfig: the controller ended the program, as argparse does.
    """
    observation, info = env.reset(seed=seed)
    building: Any = env.unwrapped
    metrics = MetricsAccumulator(building.manifest, building.reward, prices, emissions)
    recorders: list[SampleRecorder] = [metrics] if recorder is None else [metrics, recorder]
    for each in recorders:
        each.add(building.sample)

    def record(terms: Mapping[str, float] | None) -> None:
        for each in recorders:
            each.add(building.sample, terms)
        if progress is not None:
            progress(building.sample.step)

    weather, terminated, is_over = info.get("weather", ""), False, False
    with _recorded(env, record) as recorded, refuse_exit("the controller"):
        while not is_over:
            observation, _, terminated, truncated, _ = recorded.step(act(observation))
            is_over = terminated or truncated
    return metrics.result(terminated=bool(terminated)), weather


class _StepRecorder(gym.Wrapper[Any, Any, Any, Any]):
    """Passes the terms of the reward of each timestep to a function."""

    def __init__(self, env: gym.Env[Any, Any], record: Callable[[Mapping[str, float] | None], None]) -> None:
        super().__init__(env)
        self._record = record

    @override
    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        result = self.env.step(action)
        self._record(result[4].get("reward_terms"))
        return result


@contextmanager
def _recorded(
    env: gym.Env[Any, Any], record: Callable[[Mapping[str, float] | None], None]
) -> Iterator[gym.Env[Any, Any]]:
    """Return the environment with a recorder within its wrappers, which may take several timesteps in a step."""
    innermost = None
    for layer in layers(env):
        innermost = layer if isinstance(layer, gym.Wrapper) else innermost
    recorder = _StepRecorder(env.unwrapped, record)
    if innermost is None:
        yield recorder
        return
    innermost.env = recorder
    try:
        yield env
    finally:
        innermost.env = recorder.env


@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """Metrics of one episode of one controller."""

    controller: str
    episode: int
    seed: int
    weather: str
    result: EpisodeMetrics


@dataclass(frozen=True, slots=True, eq=False)
class ControllerTrace:
    """Samples and weather of a controller's episodes, besides their metrics.

    Attributes:
        trajectory: samples of the first episode.
        weathers: weather of each episode; None where there is no weather file.
        reward: the environment's reward; None without one.
    """

    trajectory: Trajectory
    weathers: tuple[EpisodeWeather | None, ...] = ()
    reward: Reward | None = None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Episodes of several controllers in the same scenario and weather.

    Attributes:
        rows: records by controller, then by episode.
        sources: by metric, the point or reward that it is derived from.
        unfit: by controller that was skipped since it does not fit the scenario, the reason.
        failures: by controller whose episodes ended with an error, as of its own code, the error; it has no rows.
        warnings: by controller whose node published any, the distinct texts of its warnings, as of severe errors that
            EnergyPlus reported in a run that goes on; the first ones if they are many.
        traces: by controller, samples and weather for reports; empty unless `evaluate` was called with `trace=True`.
        scenario: the scenario as the text of a scenario file (YAML); only with `trace=True`.
    """

    rows: tuple[EpisodeRecord, ...]
    sources: dict[str, str]
    unfit: dict[str, str] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    warnings: dict[str, list[str]] = field(default_factory=dict)
    traces: dict[str, ControllerTrace] = field(default_factory=dict)
    scenario: str = ""

    def table(self) -> list[dict[str, Any]]:
        """Return a dictionary for each row, all with the same keys; None where a metric is unknown."""
        metrics = [row.result.metrics() for row in self.rows]
        names = dict.fromkeys(name for episode in metrics for name in episode)
        return [
            {"controller": row.controller, "episode": row.episode, "seed": row.seed, "weather": row.weather}
            | {name: episode.get(name) for name in names}
            for row, episode in zip(self.rows, metrics, strict=True)
        ]

    def comparison(self, command: str = "") -> Comparison:
        """Return the content of a report, compared with the baseline control or else the first controller.

        Args:
            command: the command line that repeats the evaluation, for the report.

        Raises:
            InvalidConfig: `evaluate` was called without `trace=True`.
        """
        from zenostat.views.report import Comparison, Run

        if not self.traces:
            raise InvalidConfig("a report needs the samples of episodes: call evaluate(..., trace=True)")
        runs = []
        for name, traced in self.traces.items():
            rows = [row for row in self.rows if row.controller == name]
            runs.append(
                Run(
                    name=name,
                    results=tuple(row.result for row in rows),
                    trajectory=traced.trajectory,
                    seeds=tuple(row.seed for row in rows),
                    weather_names=tuple(row.weather for row in rows),
                    weathers=traced.weathers,
                    reward=traced.reward,
                )
            )
        failed = {name: f"it failed: {error}" for name, error in self.failures.items()}
        return Comparison(tuple(runs), self.scenario, command, self.unfit | failed, self.sources)

    def report(self, path: str | Path, *, command: str = "") -> None:
        """Write a report as one HTML file; see `comparison`, and `zenostat.report` for the figures as files.

        Raises:
            InvalidConfig: `evaluate` was called without `trace=True`; no .html file, no such folder, or no Matplotlib.
        """
        from zenostat.views.report import write_report

        write_report(self.comparison(command), path)

    def summary(self) -> dict[str, dict[str, MetricSummary]]:
        """Return statistics by controller and metric, without metrics that are unknown in some episode."""
        values: dict[str, dict[str, list[float | None]]] = {}
        for row in self.rows:
            for name, value in row.result.metrics().items():
                values.setdefault(row.controller, {}).setdefault(name, []).append(value)
        return {
            controller: {name: summarize(series) for name, series in metrics.items() if None not in series}
            for controller, metrics in values.items()
        }


def evaluate(
    scenario: str | Path | Mapping[str, Any],
    controllers: Sequence[str] | Mapping[str, str | ControllerFactory],
    *,
    episodes: int = 1,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    prices: Mapping[str, Rate] | None = None,
    emissions: Mapping[str, Rate] | None = None,
    progress: Progress | None = None,
    trace: bool = False,
    record: str | Path | None = None,
    wrappers: Sequence[Mapping[str, Any]] | None = None,
    **overrides: Any,
) -> Evaluation:
    """Run controllers one after another through the same episodes.

    Episode k is reset with `seed + k` for each controller, so that all have the same weather; a controller with a
    parameter `seed` gets `seed`. Each controller runs in a new environment. Results are reproducible. A controller
    that does not fit the scenario, or whose commands no action can express, is skipped with a reason in
    `Evaluation.unfit`. After an error in the episodes of a controller, or an end of the program in its code, the others
    still run, and `Evaluation.failures` has the error.

    Args:
        scenario: an id, a scenario file (.yaml), or arguments of `BuildingEnv` by name.
        controllers: controllers as for `load_controller`; or a mapping from
            names for the tables to such texts or to classes. `baseline` is evaluated without actuators.
        episodes: episodes per controller.
        seed: seed of the first episode, at least 0.
        parameters: parameters of the controllers; each controller gets those that it has.
        prices: price of each fuel (the keys of `zenostat.metrics.energy_meters.FUELS`, or `gas`) for the
            KPI of cost: a number in currency per kWh, a number for each hour of a year, a CSV or YAML file, or a form
            of `zenostat.time_series`.
        emissions: emission factors for the KPI of emissions, in the same forms; numbers are in kg CO2 per kWh.
        progress: callback for each timestep.
        trace: keep the samples of the first episode of each controller; see `Evaluation.report`.
        record: folder for a recording (`.mcap`) of each controller's node, which has the controller's name.
        wrappers: of these wrappers, as data, those that set actuators outside the actions (`ChangingContext`) act in
            all episodes, as do those of the scenario. Other wrappers concern what an agent sees, and are not applied.
        overrides: arguments of `BuildingEnv` that override those of the scenario. `monitoring` is on by default: nodes
            also measure what metrics, KPIs and reports need, which no controller observes.

    Raises:
        UsageError: a controller, a parameter or the scenario is invalid, or no controller fits the scenario.
        Exception: that of the first controller that failed, if no other one has any result.
    """
    if episodes < 1 or seed < 0:
        raise InvalidConfig(f"episodes={episodes}, seed={seed}: expected at least one episode and a seed of at least 0")
    settings = {**of_scenario(scenario), **overrides}
    if record is not None:
        settings["record"] = record
    add_monitoring(settings)
    wrappers = context_wrappers(wrappers or ())
    prices, emissions = read_prices(prices), read_emissions(emissions)
    factories = controller_factories(controllers)
    arguments = assign_parameters(factories, parameters or {}, seed)
    rows: dict[str, list[EpisodeRecord]] = {}
    sources: dict[str, str] = {}
    created: dict[str, ControllerProtocol] = {}
    unfit: dict[str, UsageError] = {}
    failures: dict[str, Exception] = {}
    warnings: dict[str, list[str]] = {}
    traces: dict[str, ControllerTrace] = {}
    text = ""
    for name in sorted(factories, key=lambda key: is_baseline_factory(factories[key])):
        is_baseline = is_baseline_factory(factories[name])
        with closing(_open(_named_node(settings, name), wrappers, is_baseline=is_baseline)) as env:
            if name not in created and name not in unfit:
                alike = {
                    key: factory for key, factory in factories.items() if is_baseline_factory(factory) == is_baseline
                }
                created |= _create_controllers(alike, env, arguments, unfit)
            if name not in unfit:
                try:
                    seeds = range(seed, seed + episodes)
                    recorder = TrajectoryRecorder(env.manifest) if trace else None
                    within = within_context(env, wrappers)
                    run = partial(run_episode, within, prices=prices, emissions=emissions)
                    with _node_warnings(env) as warnings[name]:
                        rows[name], weathers = _run_episodes(name, created[name], run, env, seeds, progress, recorder)
                    if recorder is not None:
                        source_names = {getattr(env.link, "name", ""): name}
                        traces[name] = ControllerTrace(recorder.trajectory(source_names), weathers, env.reward)
                        text = _scenario_text(env) if not (text and is_baseline) else text
                except InexpressibleCommands as error:
                    unfit[name] = error
                except Exception as error:  # of a user's controller; the others still run
                    failures[name] = error
            sources = MetricsAccumulator(env.manifest, env.reward, prices, emissions).sources | sources
    if not rows:
        raise next(iter((failures | unfit).values()))
    reasons = {name: str(unfit[name]) for name in factories if name in unfit}
    errors = {name: _error_text(failures[name]) for name in factories if name in failures}
    in_order = sorted(traces, key=lambda key: (not is_baseline_factory(factories[key]), list(factories).index(key)))
    return Evaluation(
        tuple(row for name in factories for row in rows.get(name, ())), sources, reasons, errors,
        {name: warnings[name] for name in factories if warnings.get(name)},
        {name: traces[name] for name in in_order}, text,
    )  # fmt: skip


def _error_text(error: Exception) -> str:
    """Return the text of an error; of one of a controller's code with its type, file and line."""
    return str(error) if isinstance(error, ZenostatError) else describe_user_error(error)


def _scenario_text(env: BuildingEnv) -> str:
    """Return the scenario as YAML; "" if the environment has no node."""
    bus = _bus(env)
    return "" if bus is None else bus.scenario(env.manifest.node)


def _bus(env: BuildingEnv) -> Bus | None:
    """Return the bus of an environment; None if its samples come from elsewhere, as in tests."""
    bus = getattr(env.link, "bus", None)
    return bus if isinstance(bus, Bus) else None


@contextmanager
def _node_warnings(env: BuildingEnv) -> Iterator[list[str]]:
    """Yield a list that has the distinct texts of the node's warnings at the end."""
    texts, bus, node = list[str](), _bus(env), env.manifest.node
    if bus is None:
        yield texts
        return
    messages: SimpleQueue[bytes] = SimpleQueue()
    with bus.session.declare_subscriber(keys.EVENT.at(node), lambda sent: messages.put(sent.payload.to_bytes())):
        yield texts
        status = bus.status(node)
        awaits_end = status.state is State.ENDED  # its event comes after the warnings of the last timestep
        with suppress(Empty):
            while awaits_end or not messages.empty():
                event = codec.decode(Event, messages.get(timeout=_EVENT_S))
                if event.kind is EventKind.WARNING and event.text not in texts and len(texts) < _MOST_WARNINGS:
                    texts.append(event.text)
                awaits_end = awaits_end and (event.kind, event.episode) != (EventKind.ENDED, status.episode[0])


def _create_controllers(
    factories: Mapping[str, ControllerFactory],
    env: BuildingEnv,
    arguments: Mapping[str, dict[str, Any]],
    unfit: dict[str, UsageError],
) -> dict[str, ControllerProtocol]:
    """Create the controllers that fit the environment; add an error to `unfit` for each other one."""
    created = {}
    for name, factory in factories.items():
        try:
            controller = make_controller(factory, env.manifest, arguments[name])
            if isinstance(controller, PlanningController):
                controller.attach(env)
            created[name] = controller
        except ControllerMismatch as error:
            unfit[name] = error
    return created


def _run_episodes(
    name: str,
    controller: ControllerProtocol,
    run: Callable[..., tuple[EpisodeMetrics, str]],
    env: BuildingEnv,
    seeds: Sequence[int],
    progress: Progress | None,
    recorder: TrajectoryRecorder | None,
) -> tuple[list[EpisodeRecord], tuple[EpisodeWeather | None, ...]]:
    """Run the episodes of a controller; record the samples of the first one, and the weather of all."""
    agent, steps = Agent(controller, env), env.manifest.steps
    rows, weathers = [], []
    for number, seed in enumerate(seeds):
        agent.seed_episode(seed)
        report = None if progress is None else partial(progress, name, number)
        result, weather = run(
            lambda _: agent.action(env.sample),
            seed=seed,
            progress=None if report is None else lambda step, report=report: report(step, steps),
            recorder=recorder if number == 0 else None,
        )
        rows.append(EpisodeRecord(name, number, seed, weather, result))
        if recorder is not None:
            weathers.append(query_weather(_bus(env), env.manifest))
    return rows, tuple(weathers)


def is_baseline_factory(factory: ControllerFactory) -> bool:
    """Whether a factory makes the baseline control, which sends no commands."""
    return isinstance(factory, type) and issubclass(factory, BaselineController)


def _named_node(settings: Mapping[str, Any], controller: str) -> dict[str, Any]:
    """Name the node of a recorded evaluation after its controller: its file and its replay have that name."""
    if settings.get("record") is None or settings.get("node") is not None:
        return dict(settings)
    if Path(settings["record"]).suffix == SUFFIX:
        raise InvalidConfig(f"{settings['record']}: an evaluation has a recording for each controller; name a folder")
    return {**settings, "node": safe_name(controller)}


def _open(settings: Mapping[str, Any], wrappers: Sequence[Mapping[str, Any]], *, is_baseline: bool) -> BuildingEnv:
    """Open the environment of a controller; that of baseline control has actuators for the context and faults alone."""
    if not is_baseline:
        return BuildingEnv(**settings)
    if not context_wrappers(wrappers) and not _has_actuator_faults(settings):
        env = BuildingEnv(**without_actuators(settings))
        if not context_wrappers(env.manifest.task.wrappers):
            return env
        env.close()
    return BuildingEnv(**without_actions(settings))


def _has_actuator_faults(settings: Mapping[str, Any]) -> bool:
    """Return whether the plan of faults names actuators; a plan that cannot be read is none, which its reader tells."""
    if settings.get("faults") is None:
        return False
    try:
        return any(getattr(fault, "actuators", ()) for fault in read_plan(Path(settings["faults"])).faults)
    except (InvalidConfig, TypeError):
        return False


def without_actions(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Keep the actuators, for wrappers that set some of them, but remove all actions: the others are never set."""
    kept = {name: value for name, value in settings.items() if name not in ("control", "discrete")}
    return (
        kept
        | {name: value for name, value in without_actuators(settings).items() if name in _OF_ACTIONS}
        | {"actions": {}}
    )


def without_actuators(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Remove all actuators, as baseline control needs: an action would always set a value.

    With them go the fields that name actions, and the sensors that relative actions add to the observation.
    """
    fields = {**fields_of_file(settings.get("file", "")), **settings}
    removed: dict[str, Any] = {"actuators": {}}
    if isinstance(fields.get("relative"), Mapping):
        removed["relative"] = {}
    unobserved = fields.get("unobserved")
    if fields.get("relative") is not None and isinstance(unobserved, list | tuple):
        own = {*(fields.get("sensors") or {}), *(fields.get("meters") or {})}
        removed["unobserved"] = [name for name in unobserved if name in own or not _ADDED_SENSOR.search(str(name))]
    return {name: value for name, value in settings.items() if name not in ("actions", "control", "discrete")} | removed


def controller_factories(
    controllers: Sequence[str] | Mapping[str, str | ControllerFactory],
) -> dict[str, ControllerFactory]:
    """Return factories by name; errors as of `evaluate`."""
    if isinstance(controllers, str) or not controllers:
        raise InvalidConfig(f"controllers: expected a list of names, such as ['baseline', 'rbc'], got {controllers!r}")
    named = controllers if isinstance(controllers, Mapping) else dict(zip(controllers, controllers, strict=True))
    if twice := repeated(controllers):
        raise InvalidConfig(f"the controller {twice[0]} is listed twice, but would give the same results")
    for name in named:
        if not name.strip() or replace_controls(name) != name:
            raise InvalidConfig(f"controllers: {name!r} is no name: a text without control characters expected")
    return {name: load_controller(entry) if isinstance(entry, str) else entry for name, entry in named.items()}


def assign_parameters(
    factories: Mapping[str, ControllerFactory], parameters: Mapping[str, Any], seed: int
) -> dict[str, dict[str, Any]]:
    """Assign each parameter to the controllers that name it, or if none does, to those with arbitrary parameters."""
    signatures = {name: list(inspect.signature(factory).parameters.values())[1:] for name, factory in factories.items()}
    known = {
        name: [p.name for p in signature if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)]
        for name, signature in signatures.items()
    }
    with_any = [name for name, signature in signatures.items() if any(p.kind is p.VAR_KEYWORD for p in signature)]
    arguments: dict[str, dict[str, Any]] = {name: {} for name in factories}
    for parameter, value in parameters.items():
        receivers = [name for name, names in known.items() if parameter in names] or with_any
        if not receivers:
            all_known = [name for names in known.values() for name in names]
            raise InvalidConfig(
                f"none of the controllers has the parameter {parameter!r}; {did_you_mean(parameter, all_known)}"
            )
        for name in receivers:
            arguments[name][parameter] = value
    for name, factory in factories.items():
        if "seed" in known[name] and "seed" not in getattr(factory, "keywords", {}):
            arguments[name].setdefault("seed", seed)
    return arguments
