"""`zenostat scenarios`: the available scenarios, and tools for scenario files."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from zenostat.cli.console import err, out
from zenostat.cli.tables import show as show_table
from zenostat.cli.tables import show_json
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownName
from zenostat.topics.plurals import counted
from zenostat.topics.user_file import check_user_file

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic import BaseModel

    from zenostat.eplus_node.plan import Plan
    from zenostat.models.scenario.schema import Scenario

scenarios = typer.Typer(
    help="List scenarios; show and check scenario files, and print their schema.", no_args_is_help=False
)


@scenarios.callback(invoke_without_command=True)
def listing(
    context: typer.Context,
    match: Annotated[str, typer.Option(help="Show only ids that contain this text.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print all ids as JSON.")] = False,
) -> None:
    """List scenarios; each id is an environment: `gym.make("zenostat/ID")`.

    Example: `zenostat scenarios --match stochastic`
    """
    if context.invoked_subcommand is not None:
        return
    from zenostat.topics.scenario_ids import PAPER_IDS, all_ids, pack_ids

    ids = [name for name in all_ids() if match.casefold() in name.casefold()]
    if as_json:
        show_json(ids)
        return
    if match:
        packs = dict.fromkeys(pack_ids(), "pack sinergym") | {name: _pack_of_paper(name) for name in PAPER_IDS}
        rows = [(name, packs.get(name, "bundled")) for name in ids]
        show_table(counted(len(ids), "scenario", ","), ("id", "from"), rows, wrap=("id",))
        return
    columns = ("building", "weathers", "actions", "ids", "from")
    show_table(f"{len(ids):,} scenarios", columns, _families(), right=("ids",), wrap=columns[:3])
    if not out.is_terminal:
        return
    out.print(
        "An id has the form BUILDING-WEATHER-ACTIONS-v1, or BUILDING-WEATHER-ACTIONS-stochastic-v1 with weather noise. "
        'Each id is an environment: gym.make("zenostat/ID"). To list ids: zenostat scenarios --match TEXT'
    )


def _families() -> list[tuple[str, ...]]:
    """Return a row for each building: weathers, kinds of actions, number of ids, origin."""
    from zenostat.topics.scenario_ids import BUILDINGS, DEMO, PACK_IDS, PAPER_IDS, WEATHERS, bundled_ids, variants

    pack = "pack sinergym"
    rows = [(DEMO, "", "", "1", pack)]
    for building, (weathers, forms) in PACK_IDS.items():
        count = len(weathers) * len(variants(building, "", forms))
        rows.append((building, ", ".join(weathers), ", ".join(forms), str(count), pack))
    for building in dict.fromkeys(name.split("-mixed-")[0] for name in PAPER_IDS):
        names = [name for name in PAPER_IDS if name.startswith(f"{building}-")]
        rows.append((building, "mixed", "continuous", str(len(names)), _pack_of_paper(names[0])))
    bundled = (f"{len(BUILDINGS)}, see zenostat buildings", f"{len(WEATHERS)}, see zenostat weathers")
    return [*rows, (*bundled, "continuous, discrete", f"{len(bundled_ids()):,}", "bundled")]


def _pack_of_paper(name: str) -> str:
    return "pack sinergym-paper" if name.startswith("paper-datacenter-") else "pack sinergym"


@scenarios.command()
def show(
    scenario: Annotated[str, typer.Argument(help="Scenario id or scenario file.")],
    brief: Annotated[bool, typer.Option("--brief", help="Print only fields that differ from the defaults.")] = False,
) -> None:
    """Print a scenario as a file that can be edited and simulated.

    Example: `zenostat scenarios show office-medium-USA_CO_Denver-discrete-v1 > mine.yaml`
    """
    from zenostat.eplus_node.config import read_base, read_config
    from zenostat.models.scenario.registry import expanded
    from zenostat.models.scenario.schema import dump

    if brief:
        described = read_base(read_config({"scenario": scenario}))
        assert described is not None
    else:
        with err.status(f"reading the points of {scenario} with EnergyPlus"):
            planned = plan_scenario({"scenario": scenario})
        described = _with_reward_defaults(expanded(planned.scenario, planned.building, planned.points, planned.task))
    sys.stdout.write("# yaml-language-server: $schema=scenario.schema.json\n")
    sys.stdout.write("# Create the schema with `zenostat scenarios schema > scenario.schema.json`.\n")
    sys.stdout.write(dump(described, defaults=not brief))


def _with_reward_defaults(scenario: Scenario) -> Scenario:
    """Return the scenario with all parameters of its reward, including defaults."""
    from zenostat.agent_sdk.rewards import REWARDS, read_reward

    if scenario.reward is None:
        return scenario
    reward = read_reward(scenario.reward)
    parameters = (
        cast("BaseModel", reward).model_dump(mode="json") if isinstance(reward, tuple(REWARDS.values())) else {}
    )
    return scenario.model_copy(update={"reward": dict(scenario.reward) | parameters})


@scenarios.command()
def check(file: Annotated[Path, typer.Argument(help="Scenario file.")]) -> None:
    """Check a scenario file without simulating: building, weather, points, actions, reward and wrappers.

    All errors are listed at once.

    Example: `zenostat scenarios check mine.yaml`
    """
    check_user_file(file, UnknownName, "a YAML file")
    with err.status(f"checking {file}"):
        planned = plan_scenario({"scenario": str(file)})
    points = planned.points
    out.print(
        f"{file}: {planned.building.name}, {', '.join(s.name for s in planned.sources)}, "
        f"{counted(planned.period.steps, 'timestep')}; {counted(len(points.sensors), 'sensor')}, "
        f"{counted(len(points.meters), 'meter')}, {counted(len(planned.task.actions), 'action')}"
    )
    for warning in planned.warnings:
        out.warning(warning)


def plan_scenario(settings: Mapping[str, Any]) -> Plan:
    """Return the plan of the scenario in a node's settings, whose reward and wrappers fit its points as well.

    Raises:
        UsageError, SimulatorError: lists the errors of all parts.
    """
    from zenostat.agent_sdk.envs.arguments import check_agent_fields
    from zenostat.agent_sdk.envs.task_check import check_task
    from zenostat.eplus_node.config import read_config
    from zenostat.eplus_node.plan import plan

    errors = ErrorCollector()
    errors.collect(lambda: check_agent_fields(settings["scenario"]))
    planned = errors.collect(lambda: plan(read_config(settings), check_task))
    errors.raise_if_any()
    return cast("Plan", planned)


def check_scenario(settings: Mapping[str, Any]) -> None:
    """Check the reward and the wrappers of a scenario file; if they are invalid, report all other errors as well.

    Raises:
        UsageError, SimulatorError: lists the errors of all parts.
    """
    from zenostat.agent_sdk.envs.arguments import check_agent_fields

    try:
        check_agent_fields(settings["scenario"])
    except InvalidConfig:
        plan_scenario(settings)


@scenarios.command()
def schema() -> None:
    """Print the JSON schema of scenario files, for completion and validation in editors.

    Example: `zenostat scenarios schema > scenario.schema.json`
    """
    show_json(scenario_schema())


def scenario_schema() -> dict[str, Any]:
    """Return the schema of scenario files, including the rewards' parameters, which `agent_sdk` defines."""
    from zenostat.agent_sdk.rewards import REWARDS
    from zenostat.models.scenario.schema import Scenario
    from zenostat.topics.scenario_fields import MEANING

    schema = Scenario.model_json_schema()
    rewards = []
    for reward in REWARDS.values():
        reward_schema = reward.model_json_schema(ref_template="#/$defs/{model}")
        schema["$defs"].update(reward_schema.pop("$defs", {}))
        reward_schema["required"] = ["kind", *reward_schema.get("required", [])]
        schema["$defs"][reward.__name__] = reward_schema
        rewards.append({"$ref": f"#/$defs/{reward.__name__}"})
    schema["properties"]["reward"] = {"anyOf": [*rewards, {"type": "null"}]}
    for name, field_schema in schema["properties"].items():
        field_schema["description"] = MEANING[name]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
