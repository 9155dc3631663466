"""What a node is asked to simulate and how, and the checking of it before anything starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from bridge.faults import read_plan
from bridge.runtime.affinity import Affinity
from bridge.transport.session import DEFAULT_ENDPOINT
from eplus_node.engine.registry import UNRESPONSIVE_S
from eplus_node.fault_injection import FaultInjection
from models import catalog
from models.building import conflicts
from models.building import model as building
from models.building.model import Building
from models.points import discovery, selection
from models.points.discovery import PointCatalog
from models.points.selection import Points
from models.scenario.episode import WeatherSource
from models.scenario.registry import find_scenario
from models.scenario.run_period import Period, check_steps_per_hour, parse_day
from models.scenario.schema import ActuatorSpec, Scenario, load_scenario, read_scenario
from models.scenario.task import task_of
from models.weather import design_days, epw, noise
from models.weather.header import check_covers, read_header
from topics.codec import describe_validation_errors
from topics.errors import ErrorCollector, InvalidConfig, UnknownName, did_you_mean
from topics.fault_plan import FaultPlan, Loss
from topics.keys import check_name
from topics.messages import Aggregation, Mode, Policy, Task


class NodeConfig(BaseModel):
    """The settings of a node.

    Attributes:
        scenario: an id or a file; or None.
        config: a Sinergym configuration instead, and which `variant` of it (`hot-continuous`; None: its first).
        what: fields of a scenario, which go before those of `scenario`.
        own_reward: the agent has a reward of its own; that of a Sinergym configuration is not read.
        output_dir: a folder for EnergyPlus's own files, an episode each; those of the last `keep_last` finished
            episodes and of the running one (None: of all, or as many as the Sinergym configuration says).
        check: only check everything, and start nothing.
        listen: endpoints; none for a node that only connects, to a router or another node.
        unresponsive_s: time after which an engine that neither answers nor uses processor time is killed.
        keys: a folder that `zenostat keys init` made; `certificate` names another certificate than `node`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenario: str | None = None
    config: Path | None = None
    variant: str | None = None
    what: dict[str, Any] = Field(default_factory=dict)
    own_reward: bool = False
    check: bool = False
    name: str = "building"
    mode: Mode = Mode.LOCKSTEP
    speed: Annotated[float, Field(gt=0, le=1e9)] = 1.0
    policy: Policy = Policy.WAIT
    grace_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    deadline_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    faults: Path | None = None
    listen: list[str] = Field(default_factory=lambda: [DEFAULT_ENDPOINT])
    connect: list[str] = Field(default_factory=list)
    expose: bool = False
    keys: Path | None = None
    certificate: str | None = None
    slots: Annotated[int, Field(ge=1, le=256)] = 1
    baseline: bool = False
    branches: Annotated[int, Field(ge=0, le=4096)] = 64
    unresponsive_s: Annotated[float, Field(gt=0, le=1e9)] = UNRESPONSIVE_S
    output_dir: Path | None = None
    keep_last: Annotated[int, Field(ge=1)] | None = None
    folder: Path | None = None
    affinity: Affinity = Affinity.SEPARATE_CORES
    cpu: int | None = None
    engine_cpu: int | None = None

    @model_validator(mode="after")
    def _has_a_bus(self) -> NodeConfig:
        if not self.listen and not self.connect:
            raise ValueError("name an endpoint to listen on, or one to connect to")
        return self


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked configuration: everything that can be known before EnergyPlus runs.

    `warnings`: what in the model works against the scenario's actuators. `faults`: what is injected.
    """

    config: NodeConfig
    scenario: Scenario
    building: Building
    sources: tuple[WeatherSource, ...]
    period: Period
    points: Points
    task: Task
    warnings: tuple[str, ...]
    faults: FaultPlan | None = None


def read_config(settings: Mapping[str, Any]) -> NodeConfig:
    """The settings as a `NodeConfig`; those of a scenario stand beside those of the node.

    Raises:
        InvalidConfig: names all faults at once.
    """
    own = {name: value for name, value in settings.items() if name in NodeConfig.model_fields}
    what = {name: value for name, value in settings.items() if name in Scenario.model_fields}
    known = [*NodeConfig.model_fields, *Scenario.model_fields]
    unknown = [f"no setting {name!r}; {did_you_mean(name, known)}" for name in settings if name not in known]
    if unknown:
        raise InvalidConfig("\n".join(unknown))
    try:
        return NodeConfig.model_validate({"what": what, **own})
    except ValidationError as error:
        raise InvalidConfig(describe_validation_errors(error)) from None


def kept_episodes(config: NodeConfig) -> int | None:
    """How many finished episodes' files are kept; None is all of them."""
    if config.keep_last is not None or config.config is None or config.output_dir is None:
        return config.keep_last
    from models.sinergym.scenarios import kept_episodes as of_sinergym

    return of_sinergym(config.config)


def read_base(config: NodeConfig, errors: ErrorCollector | None = None) -> Scenario | None:
    """The scenario that the settings name, if they do. `errors`: as in `read_scenario`."""
    if config.config is not None:
        from models.sinergym.scenarios import scenario_of as of_sinergym  # few need it, and it takes a while

        overridden = {name for name, value in config.what.items() if value is not None}
        overridden |= {"reward"} if config.own_reward else set()
        overridden |= {"period"} if {"begin", "end"} <= overridden else set()
        return of_sinergym(config.config, config.variant, overridden=overridden)
    if config.scenario is None:
        return None
    path = Path(config.scenario).expanduser()
    return load_scenario(path, errors) if path.suffix in (".yaml", ".yml") else find_scenario(config.scenario)


def scenario_of(config: NodeConfig, errors: ErrorCollector | None = None) -> Scenario:
    """The scenario with all that the settings say over it. `errors`: as in `read_scenario`.

    Raises:
        UnknownName, InvalidConfig: no such scenario, or a field of it that cannot be.
    """
    base, given = read_base(config, errors), {name: value for name, value in config.what.items() if value is not None}
    if base is None:
        missing = [name for name in ("building", "weather") if name not in given]
        if missing:
            raise InvalidConfig(f"name a scenario, or a building and a weather ({' and '.join(missing)} missing)")
        return read_scenario(given, "the settings", errors)
    if not given:
        return base
    changed = {"actuators", "actions", "control", "building"} & set(given)
    fields = base.model_dump(exclude_unset=True)
    if changed:  # what was said of the former actuators does not hold for others
        stale = {"actions", "discrete"} | ({"sensors", "meters", "actuators"} if "building" in changed else set())
        fields = {name: value for name, value in fields.items() if name not in stale or isinstance(value, int)}
    return read_scenario(fields | given, "the settings", errors)


def plan(config: NodeConfig) -> Plan:
    """Finds and checks the scenario: building, edits, weather, run period, points, task.

    Raises:
        UnknownName: a scenario, building, weather or point that is not there.
        InvalidConfig: settings that cannot be.
        ModelError: a model that EnergyPlus cannot read.
    """
    check_name(config.name, "the node's name")
    faults = ErrorCollector()
    scenario = scenario_of(config, faults)
    named = scenario.building or None  # what was missing or wrong is told already
    plain = faults.collect(lambda: building.read_building(catalog.find_building(named))) if named else None
    # What cannot be changed in the model is no reason not to look at the rest.
    model = faults.collect(lambda: building.with_edits(plain, scenario.edits)) or plain if plain is not None else None
    sources = tuple(faults.collect(lambda name=name: _source(name, scenario)) for name in scenario.weather if name)  # type: ignore[misc]
    faults.collect(lambda: noise.resolve_columns(scenario.weather_noise))
    if config.output_dir is not None and config.output_dir.exists() and not config.output_dir.is_dir():
        faults.errors.append(InvalidConfig(f"output_dir={config.output_dir} is a file; name a folder"))
    period = chosen = task = None
    if _dates_are_right(scenario, faults) and model is not None:
        period = faults.collect(lambda: model.period(scenario.begin, scenario.end, scenario.steps_per_hour))
    found = [source for source in sources if source is not None]
    if period is not None:
        for source in found:
            faults.collect(lambda source=source: check_covers(source.header, period, source.name))  # type: ignore[misc]
    if model is not None and found:
        chosen = faults.collect(lambda: _points(model, scenario, found[0].path))
    if chosen is not None:
        task = faults.collect(lambda: task_of(scenario, chosen))
    file = config.faults
    injected = faults.collect(lambda: read_plan(file)) if file is not None else None
    faults.raise_if_any()
    assert model is not None
    assert period is not None
    assert chosen is not None
    assert task is not None
    warnings = tuple(conflicts.conflicts(model.objects, chosen.actuators)) + _waits_for_what_is_lost(config, injected)
    planned = Plan(config, scenario, model, tuple(found), period, chosen, task, warnings, injected)
    if injected is not None:
        FaultInjection(injected, planned, config.slots)  # so that its mistakes are known before anything starts
    return planned


def _dates_are_right(scenario: Scenario, errors: ErrorCollector) -> bool:
    """Check what can be known of the run period without the model."""
    before = len(errors.errors)
    for what, day in (("begin", scenario.begin), ("end", scenario.end)):
        if day is not None:
            errors.collect(lambda what=what, day=day: parse_day(day, what))  # type: ignore[misc]
    steps = scenario.steps_per_hour
    if steps is not None:
        errors.collect(lambda: check_steps_per_hour(steps))
    return len(errors.errors) == before


def _waits_for_what_is_lost(config: NodeConfig, faults: FaultPlan | None) -> tuple[str, ...]:
    lost = [fault.name or fault.kind for fault in faults.faults if isinstance(fault, Loss)] if faults else []
    if (
        not lost
        or config.mode is not Mode.LOCKSTEP
        or (config.deadline_s is not None and config.policy is not Policy.WAIT)
    ):
        return ()
    return (
        f"the fault {', '.join(lost)} loses messages, and in lockstep whoever waits for one waits for ever; "
        "give a deadline and a policy (--deadline 0.5 --policy hold)",
    )


def _source(name: str, scenario: Scenario) -> WeatherSource:
    entry = catalog.find_weather(name)
    header = read_header(entry.path)
    if scenario.weather_noise:
        epw.read(entry.path)
    site = design_days.site(entry.path, header) if scenario.sizing == "weather" else None
    return WeatherSource(entry.name, entry.path, header, site)


def _points(model: Building, scenario: Scenario, any_weather: Path) -> Points:
    offered = discovery.discover(model, any_weather)
    actuators = None
    if scenario.actuators is not None:
        actuators = {name: _actuator(model, offered, name, spec) for name, spec in scenario.actuators.items()}
    sensors = selection.default_sensors(offered) if scenario.sensors is None else {}
    specs: dict[str, list[str]] = {name: list(spec) for name, spec in sensors.items()}
    for name, sensor in (scenario.sensors or {}).items():
        specs[name] = [sensor.variable, sensor.key, *([sensor.aggregation] if sensor.aggregation else [])]
    if scenario.aggregation is not None:
        summed = {v.name.casefold(): v.summed for v in offered.variables}
        for spec in specs.values():
            if len(spec) == 2:
                reported = Aggregation.SUM if summed.get(spec[0].casefold()) else Aggregation.MEAN
                spec.append(Aggregation.INSTANT if scenario.aggregation is Aggregation.INSTANT else reported)
    chosen = selection.select_points(model, offered, specs, scenario.meters, actuators)
    if actuators is not None:
        return chosen
    idle = conflicts.overridden_actuators(
        model.objects, chosen.actuators
    )  # nobody named them: what has no effect is left out
    return replace(chosen, actuators=tuple(a for a in chosen.actuators if a.name not in idle))


def _actuator(model: Building, offered: PointCatalog, name: str, spec: ActuatorSpec) -> list[object]:
    """A bound that the scenario leaves out is the model's own."""
    names = [spec.component_type, spec.control_type, spec.key]
    if spec.low is None and spec.high is None:
        return [*names]
    try:
        low, high = selection.actuator_bounds(model, selection.find_actuator(offered, name, *names))
    except UnknownName:
        return [*names]  # said, with all else that is unknown, by the choice of the points
    return [*names, low if spec.low is None else spec.low, high if spec.high is None else spec.high]
