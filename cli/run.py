"""`zenostat run`: run a controller in its own process."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import err, out, progress
from zenostat.cli.options import DEFAULTS, BusOptions, Emissions, Price, on_bus
from zenostat.cli.pairs import read_parameters, read_rates
from zenostat.cli.reports import FIGURES_HELP, REPORT_HELP, ReportOutputs, command_line
from zenostat.cli.results import show_results
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import safe_name
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from rich.progress import Progress

    from zenostat import Bus, ControllerLink
    from zenostat.agent_sdk.controllers import Agent
    from zenostat.agent_sdk.semantic import SemanticGraph
    from zenostat.cli.run_trace import RunTrace
    from zenostat.metrics.episode_metrics import EpisodeMetrics, MetricsAccumulator


@on_bus
def run(
    node: Annotated[str, typer.Option(help="Name of the node.")],
    controller: Annotated[
        str,
        typer.Option(
            help="baseline (no commands), rbc (rules on comfort bands), fixed, setback (by the clock), offsets, "
            "incremental, pid, coordinator (of districts), portable-setback, portable-limit, random, oracle (only in "
            "environments); a controller file (best.yaml of `zenostat tune`); a training's folder, ppo:model.zip or an "
            "exported policy (FILE.npz); or your own class: path/to/file.py:MyController or "
            "package.module:MyController."
        ),
    ] = "rbc",
    parameters: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Parameter of the controller; repeatable.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Seed of the controller, and of the first episode that this command starts."
        ),
    ] = None,
    options: BusOptions = DEFAULTS,
    priority: Annotated[
        int, typer.Option(min=1, max=16, metavar="1-16", help="Priority of the commands; 1 is the highest.")
    ] = 10,
    episodes: Annotated[int, typer.Option(min=1, metavar="N", help="Number of episodes to control.")] = 1,
    prices: Price = None,
    emissions: Emissions = None,
    reset: Annotated[
        bool, typer.Option("--reset", help="Start a new episode instead of joining the running one.")
    ] = False,
    report: Annotated[Path | None, typer.Option(help=REPORT_HELP)] = None,
    figures: Annotated[Path | None, typer.Option(help=FIGURES_HELP)] = None,
) -> None:
    """Control a node, from its present sample to the end of the episode.

    Example: `zenostat run --node office --controller rbc --set margin=0.5`
    """
    outputs = ReportOutputs(report, figures)
    from zenostat.agent_sdk.controllers import Agent, load_controller, make_controller
    from zenostat.metrics.episode_metrics import MetricsAccumulator
    from zenostat.metrics.fuel_rates import read_emissions, read_prices

    rates = read_prices(read_rates("--price", prices)), read_emissions(read_rates("--emissions", emissions))
    factory = load_controller(controller)
    starts_episode = reset or episodes > 1
    arguments = _with_seed(factory, read_parameters(parameters), seed, starts_episode, controller)
    name = safe_name(controller.rpartition(":")[2])
    with options.open_bus(resets=starts_episode) as bus:
        agent = Agent(make_controller(factory, bus.manifest(node), arguments), semantic=lambda: _semantic(bus, node))
        results: dict[str, tuple[EpisodeMetrics, float]] = {}
        trace = _trace(bus, node, controller, rates) if outputs.wanted else None
        with bus.controller(node, name=name, priority=priority) as link, progress() as bars:
            for number in range(episodes):
                episode_seed = seed if reset or number else None
                if reset or number:
                    link.reset(seed=seed)
                    seed = None  # later episodes continue the seed sequence
                heading = controller if episodes == 1 else f"episode {number + 1}"
                metrics = MetricsAccumulator(link.manifest, None, *rates)
                results[heading] = _episode(link, agent, metrics, bars, trace)
                if trace is not None:
                    trace.end_episode(link, results[heading][0], episode_seed)
        if trace is not None:
            outputs.write(trace.comparison(command_line()))
    slots = link.manifest.slots
    of_slot = f", slot 0 of {slots}" if slots > 1 else ""
    out.print(f"{node}{of_slot}: {counted(episodes, 'episode')} controlled by {controller}")
    show_results(results, ", ".join(filter(None, (link.manifest.building, link.manifest.weather))))
    lost = sum(result.lost for result, _ in results.values())
    if lost:
        text = f"{counted(lost, 'sample', ',')} of {node} were lost; the totals lack their timesteps"
        err.print(f"{text}: the controller is slower than the node")
    outputs.show()


def _semantic(bus: Bus, node: str) -> SemanticGraph:
    from zenostat.agent_sdk import semantic  # needs rdflib

    return semantic.read(bus, node)


def _trace(bus: Bus, node: str, controller: str, rates: tuple[Any, Any]) -> RunTrace:
    from zenostat.cli.run_trace import RunTrace  # only for a report

    return RunTrace(bus, node, controller, *rates)


def _episode(
    link: ControllerLink, agent: Agent, metrics: MetricsAccumulator, bars: Progress, trace: RunTrace | None
) -> tuple[EpisodeMetrics, float]:
    """Answer all samples of one episode and show progress; return its metrics and its timesteps per second."""
    bar = bars.add_task(f"{link.manifest.node}: {link.name}", total=link.manifest.steps, rate="")
    rate = 0.0
    start, first, shown = time.monotonic(), None, 0.0
    for sample in link:
        if not sample.truncated:
            sample.send(agent.values(sample))
        if trace is not None:
            trace.add(sample)
        if first is None:
            first = sample.step
            metrics.begin(sample)  # earlier timesteps were not under this controller
        else:
            metrics.add(sample)
        now = time.monotonic()
        if now - shown > 0.1 or sample.truncated:
            shown = now
            rate = (sample.step - first) / max(now - start, 1e-9)
            bars.update(bar, completed=sample.step, rate=f"{rate:,.0f} steps/s")
    return metrics.result(), rate


def _with_seed(
    factory: Callable[..., Any], parameters: dict[str, Any], seed: int | None, starts_episode: bool, name: str
) -> dict[str, Any]:
    """Add the seed to the parameters of a controller that has one."""
    if seed is None:
        return parameters
    if "seed" in inspect.signature(factory).parameters:
        if "seed" in parameters:
            raise InvalidConfig(f"--seed {seed} conflicts with --set seed={parameters['seed']}; use one of them")
        return {**parameters, "seed": seed}
    if not starts_episode:
        raise InvalidConfig(
            f"--seed {seed} has no effect: {name} is not random and joins a running episode; add --reset"
        )
    return parameters
