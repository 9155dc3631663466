"""`zenostat scenarios`: what there is to be controlled, and scenario files."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from cli.console import err, out
from cli.tables import show as show_table
from topics.errors import ErrorCollector, InvalidConfig, UnknownName

if TYPE_CHECKING:
    from pydantic import BaseModel

    from models.scenario.schema import Scenario

scenarios = typer.Typer(help="Lists scenarios; shows, checks and describes scenario files.", no_args_is_help=False)


@scenarios.callback(invoke_without_command=True)
def listing(
    context: typer.Context,
    match: Annotated[str, typer.Option(help="Only ids that contain this text.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print all ids as JSON.")] = False,
) -> None:
    """Lists scenarios; each is an environment: `gym.make("zenostat/ID")`.

    Example: `zenostat scenarios --match stochastic`
    """
    if context.invoked_subcommand is not None:
        return
    from topics.scenario_ids import bundled_ids, pack_ids

    found = [name for name in (*pack_ids(), *bundled_ids()) if match.casefold() in name.casefold()]
    if as_json:
        json.dump(found, sys.stdout, indent=1)
        sys.stdout.write("\n")
        return
    if match:
        packed = set(pack_ids())
        rows = [(name, "pack sinergym" if name in packed else "bundled") for name in found]
        show_table(f"{len(found):,} scenarios", ("id", "from"), rows, wrap=("id",))
        return
    columns = ("building", "weathers", "actions", "ids", "from")
    show_table(f"{len(found):,} scenarios", columns, _families(), right=("ids",), wrap=columns[:3])
    if not out.is_terminal:
        return
    out.print(
        "An id is BUILDING-WEATHER-ACTIONS-v1, or BUILDING-WEATHER-ACTIONS-stochastic-v1 with noise on the weather; "
        'each is an environment, gym.make("zenostat/ID"). The ids themselves: zenostat scenarios --match TEXT',
        markup=False,
    )


def _families() -> list[tuple[str, ...]]:
    """A row for each building: its weathers, its kinds of actions, how many ids those make, and where they are from."""
    from topics.scenario_ids import BUILDINGS, DEMO, PACK_IDS, WEATHERS, bundled_ids, variants

    pack = "pack sinergym"
    rows = [(DEMO, "", "", "1", pack)]
    for building, (weathers, forms) in PACK_IDS.items():
        count = len(weathers) * len(variants(building, "", forms))
        rows.append((building, ", ".join(weathers), ", ".join(forms), str(count), pack))
    everything = (f"{len(BUILDINGS)}, see zenostat buildings", f"{len(WEATHERS)}, see zenostat weathers")
    return [*rows, (*everything, "continuous, discrete", f"{len(bundled_ids()):,}", "bundled")]


@scenarios.command()
def show(
    scenario: Annotated[str, typer.Argument(help="Id, or a scenario file.")],
    brief: Annotated[bool, typer.Option("--brief", help="Only what differs from the defaults.")] = False,
) -> None:
    """Prints a scenario as a file that can be edited and simulated.

    Example: `zenostat scenarios show office-medium-USA_CO_Denver-discrete-v1 > mine.yaml`
    """
    from eplus_node.config import plan, read_base, read_config
    from models.scenario.registry import expanded
    from models.scenario.schema import dump

    config = read_config({"scenario": scenario})
    if brief:
        found = read_base(config)
        assert found is not None
    else:
        with err.status(f"asking EnergyPlus about {scenario}"):
            planned = plan(config)
        found = _with_reward(expanded(planned.scenario, planned.building, planned.points, planned.task))
    sys.stdout.write("# yaml-language-server: $schema=scenario.schema.json\n")
    sys.stdout.write("# (made by `zenostat scenarios schema > scenario.schema.json`)\n")
    sys.stdout.write(dump(found, defaults=not brief))


def _with_reward(scenario: Scenario) -> Scenario:
    """The scenario with all parameters of its reward, those that have their defaults included."""
    from agent_sdk.rewards import REWARDS, read_reward

    if scenario.reward is None:
        return scenario
    reward = read_reward(scenario.reward)
    whole = cast("BaseModel", reward).model_dump(mode="json") if isinstance(reward, tuple(REWARDS.values())) else {}
    return scenario.model_copy(update={"reward": dict(scenario.reward) | whole})


@scenarios.command()
def check(file: Annotated[Path, typer.Argument(help="A scenario file.")]) -> None:
    """Checks a scenario file, its building, weather and points; starts no simulation.

    Example: `zenostat scenarios check mine.yaml`
    """
    from agent_sdk.rewards import read_reward
    from eplus_node.config import plan, read_config
    from models.scenario.schema import load_scenario

    faults = ErrorCollector()
    if not file.is_file():
        raise UnknownName(f"there is no file {file.absolute()}")
    with err.status(f"checking {file}"):
        read = faults.collect(lambda: load_scenario(file))
        reward = read.reward if read is not None else None
        if reward is not None:
            faults.collect(lambda: read_reward(reward))
        planned = faults.collect(lambda: plan(read_config({"scenario": str(file)}))) if read is not None else None
    faults.raise_if_any()
    if planned is None:
        raise InvalidConfig(f"{file} could not be read")
    points = planned.points
    out.print(
        f"{file}: {planned.building.name}, {', '.join(s.name for s in planned.sources)}, {planned.period.steps} "
        f"timesteps; {len(points.sensors)} sensors, {len(points.meters)} meters, {len(planned.task.actions)} actions"
    )
    for warning in planned.warnings:
        out.print(f"warning: {warning}", style="yellow", markup=False)


@scenarios.command()
def schema() -> None:
    """Prints the JSON schema of a scenario file, for editors that complete and check by it.

    Example: `zenostat scenarios schema > scenario.schema.json`
    """
    json.dump(scenario_schema(), sys.stdout, indent=1)
    sys.stdout.write("\n")


def scenario_schema() -> dict[str, Any]:
    """The schema with the rewards' parameters in it, which are another room's."""
    from agent_sdk.rewards import REWARDS
    from models.scenario.schema import Scenario

    found = Scenario.model_json_schema()
    kinds = []
    for kind in REWARDS.values():
        own = kind.model_json_schema(ref_template="#/$defs/{model}")
        found["$defs"].update(own.pop("$defs", {}))
        own["required"] = ["kind", *own.get("required", [])]
        found["$defs"][kind.__name__] = own
        kinds.append({"$ref": f"#/$defs/{kind.__name__}"})
    found["properties"]["reward"] = {
        "anyOf": [*kinds, {"type": "null"}],
        "description": "What the agent is rewarded for; null: nothing.",
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}
