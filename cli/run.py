"""`zenostat run`: a controller in a process of its own."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bridge.transport.session import default_endpoint
from cli.console import out, progress
from cli.options import CertificateName, Connect, Keys
from cli.results import show_results
from topics.errors import InvalidConfig
from topics.keys import safe_name

if TYPE_CHECKING:
    from rich.progress import Progress

    from agent_sdk import ControllerLink
    from agent_sdk.controllers import Agent
    from agent_sdk.evaluation.metrics import EpisodeMetrics

_WORDS = {"true": True, "false": False}


def run(
    node: Annotated[str, typer.Option(help="The node's name.")],
    controller: Annotated[
        str,
        typer.Option(
            help="building (its own control), rbc (rules on comfort bands), random, fixed, setback (by the clock), "
            "incremental, pid; or a class of your own: path/to/file.py:MyController or package.module:MyController."
        ),
    ] = "rbc",
    parameters: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A parameter of the controller; repeated.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="Of what the controller draws, and of the first episode begun here."),
    ] = None,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    priority: Annotated[
        int, typer.Option(min=1, max=16, metavar="1-16", help="Priority level; 1 is the highest.")
    ] = 10,
    episodes: Annotated[int, typer.Option(min=1, metavar="N", help="How many episodes to control.")] = 1,
    reset: Annotated[bool, typer.Option("--reset", help="Begin a new episode instead of joining.")] = False,
) -> None:
    """Controls a node, from the sample that it stands at to the episode's end.

    Example: `zenostat run --node office --controller rbc --set margin=0.5`
    """
    from agent_sdk import connect as connect_bus
    from agent_sdk.controllers import Agent, load_controller, make_controller

    made_by = load_controller(controller)
    given = _seeded(made_by, read_parameters(parameters or []), seed, begins=reset or episodes > 1, name=controller)
    name = safe_name(controller.rpartition(":")[2])
    with connect_bus(connect or default_endpoint(keys), keys=keys, certificate=certificate) as bus:
        agent = Agent(make_controller(made_by, bus.manifest(node), given))
        results: dict[str, tuple[EpisodeMetrics, float]] = {}
        with bus.controller(node, name=name, priority=priority) as link, progress() as bars:
            for number in range(episodes):
                if reset or number:
                    link.reset(seed=seed)
                    seed = None  # the sequence that it began goes on
                heading = controller if episodes == 1 else f"episode {number + 1}"
                results[heading] = _episode(link, agent, bars)
    out.print(f"{node}: {episodes} episode{'s' if episodes > 1 else ''} controlled by {controller}")
    show_results(results, f"{link.manifest.building}, {link.manifest.weather}")


def _episode(link: ControllerLink, agent: Agent, bars: Progress) -> tuple[EpisodeMetrics, float]:
    """Answer all samples to the episode's end, and show how far it is; its totals and its timesteps per second."""
    from agent_sdk.evaluation.metrics import MetricsAccumulator

    bar = bars.add_task(f"{link.manifest.node}: {link.name}", total=link.manifest.steps, rate="")
    tally, rate = MetricsAccumulator(link.manifest), 0.0
    start, first, shown = time.monotonic(), None, 0.0
    for sample in link:
        if not sample.truncated:
            sample.send(agent.values(sample))
        if first is None:
            first = sample.step
            tally.begin(sample)  # an earlier timestep was not this controller's
        else:
            tally.add(sample)
        now = time.monotonic()
        if now - shown > 0.1 or sample.truncated:
            shown = now
            rate = (sample.step - first) / max(now - start, 1e-9)
            bars.update(bar, completed=sample.step, rate=f"{rate:,.0f} steps/s")
    return tally.result(), rate


def read_parameters(given: Sequence[str]) -> dict[str, Any]:
    """`name=value` texts by name; a value is a number, true or false where it reads as one, else a text.

    Raises:
        InvalidConfig: another form, or a name that stands twice.
    """
    found: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InvalidConfig(f"--set {text}: a name and a value expected, as --set margin=0.5")
        if name in found:
            raise InvalidConfig(f"--set {name} stands twice: {found[name]} and {value}")
        found[name] = _read(value)
    return found


def _read(text: str) -> bool | float | str:
    if text.casefold() in _WORDS:
        return _WORDS[text.casefold()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _seeded(
    made_by: Callable[..., Any], given: dict[str, Any], seed: int | None, *, begins: bool, name: str
) -> dict[str, Any]:
    """The parameters with the seed, where the controller takes one."""
    if seed is None:
        return given
    if "seed" in inspect.signature(made_by).parameters:
        if "seed" in given:
            raise InvalidConfig(f"--seed {seed} and --set seed={given['seed']}: leave one of them out")
        return {**given, "seed": seed}
    if not begins:
        raise InvalidConfig(
            f"--seed {seed} rules nothing: {name} draws nothing and joins a running episode; add --reset"
        )
    return given
