"""The settings of a node, and the plan that results from checking them before anything starts."""

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
        config: a Sinergym configuration instead, and its `variant` (`hot-continuous`; None: the first one).
        what: fields of a scenario; they override those of `scenario`.
        own_reward: the agent has a custom reward; the reward of a Sinergym configuration is not read.
        check: only check the settings; start nothing.
        listen: endpoints; empty for a node that only connects to a router or another node.
        keys: a folder created by `zenostat keys init`; `certificate` names another certificate than `node`.
        unresponsive_s: time after which an engine that neither answers nor uses processor time is killed.
        shrink_caches: shrink EnergyPlus's cache of saturation pressures in its memory (experimental): a step takes
            about 9 % less, and a branch 16 MB less memory, with equal results. See `eplus_node.engine.memory`.
        output_dir: a folder for EnergyPlus's output files, one folder per episode. The files of the running episode and
            of the last `keep_last` finished ones are kept (None: all, or as the Sinergym configuration defines).
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
    shrink_caches: bool = True
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
    """A checked configuration: everything that can be determined before EnergyPlus runs.

    Attributes:
        warnings: objects of the model that override the scenario's actuators, and faults that would block the node.
        faults: faults to inject.
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
    """Validate settings, which contain the fields of the node and of the scenario side by side.

    Raises:
        InvalidConfig: lists all errors.
    """
    node_fields = {name: value for name, value in settings.items() if name in NodeConfig.model_fields}
    scenario_fields = {name: value for name, value in settings.items() if name in Scenario.model_fields}
    known = [*NodeConfig.model_fields, *Scenario.model_fields]
    unknown = [f"no setting {name!r}; {did_you_mean(name, known)}" for name in settings if name not in known]
    if unknown:
        raise InvalidConfig("\n".join(unknown))
    try:
        return NodeConfig.model_validate({"what": scenario_fields, **node_fields})
    except ValidationError as error:
        raise InvalidConfig(describe_validation_errors(error)) from None


def kept_episodes(config: NodeConfig) -> int | None:
    """Return the number of finished episodes whose files are kept; None keeps all."""
    if config.keep_last is not None or config.config is None or config.output_dir is None:
        return config.keep_last
    from models.sinergym.scenarios import kept_episodes as sinergym_kept_episodes

    return sinergym_kept_episodes(config.config)


def read_base(config: NodeConfig, errors: ErrorCollector | None = None) -> Scenario | None:
    """Return the scenario that the settings name, or None. `errors`: as in `read_scenario`."""
    if config.config is not None:
        from models.sinergym.scenarios import scenario_of as sinergym_scenario  # rarely needed, and slow to import

        overridden = {name for name, value in config.what.items() if value is not None}
        overridden |= {"reward"} if config.own_reward else set()
        overridden |= {"period"} if {"begin", "end"} <= overridden else set()
        return sinergym_scenario(config.config, config.variant, overridden=overridden)
    if config.scenario is None:
        return None
    path = Path(config.scenario).expanduser()
    return load_scenario(path, errors) if path.suffix in (".yaml", ".yml") else find_scenario(config.scenario)


def scenario_of(config: NodeConfig, errors: ErrorCollector | None = None) -> Scenario:
    """Return the scenario with the fields that the settings override. `errors`: as in `read_scenario`.

    Raises:
        UnknownName, InvalidConfig: no such scenario, or invalid fields.
    """
    base = read_base(config, errors)
    overrides = {name: value for name, value in config.what.items() if value is not None}
    if base is None:
        missing = [name for name in ("building", "weather") if name not in overrides]
        if missing:
            raise InvalidConfig(f"name a scenario, or a building and a weather ({' and '.join(missing)} missing)")
        return read_scenario(overrides, "the settings", errors)
    if not overrides:
        return base
    changed = {"actuators", "actions", "control", "building"} & set(overrides)
    fields = base.model_dump(exclude_unset=True)
    if changed:  # fields that refer to actuators of the base are invalid for others
        stale = {"actions", "discrete"} | ({"sensors", "meters", "actuators"} if "building" in changed else set())
        fields = {name: value for name, value in fields.items() if name not in stale or isinstance(value, int)}
    return read_scenario(fields | overrides, "the settings", errors)


def plan(config: NodeConfig) -> Plan:
    """Find and check the scenario: building, edits, weather, run period, points, task.

    Raises:
        UnknownName: no such scenario, building, weather or point.
        InvalidConfig: invalid settings.
        ModelError: EnergyPlus cannot read the model.
    """
    check_name(config.name, "the node's name")
    errors = ErrorCollector()
    scenario = scenario_of(config, errors)
    building_name = scenario.building or None  # a missing or wrong name is an error already
    plain = (
        errors.collect(lambda: building.read_building(catalog.find_building(building_name))) if building_name else None
    )
    # Failed edits are reported; the unedited model serves to check the rest.
    model = errors.collect(lambda: building.with_edits(plain, scenario.edits)) or plain if plain is not None else None
    sources = tuple(errors.collect(lambda name=name: _source(name, scenario)) for name in scenario.weather if name)  # type: ignore[misc]
    errors.collect(lambda: noise.checked(scenario.weather_noise))
    output_dir = config.output_dir
    if output_dir is not None:
        errors.collect(lambda: _check_output_dir(output_dir))
    period = chosen = task = None
    if _dates_are_valid(scenario, errors) and model is not None:
        period = errors.collect(lambda: model.period(scenario.begin, scenario.end, scenario.steps_per_hour))
    valid_sources = [source for source in sources if source is not None]
    if period is not None:
        for source in valid_sources:
            errors.collect(lambda source=source: epw.check_covers(source.header, period, source.name))  # type: ignore[misc]
    if model is not None and valid_sources:
        chosen = errors.collect(lambda: _points(model, scenario, valid_sources[0].path))
    if chosen is not None:
        task = errors.collect(lambda: task_of(scenario, chosen))
    file = config.faults
    injected = errors.collect(lambda: read_plan(file)) if file is not None else None
    errors.raise_if_any()
    assert model is not None
    assert period is not None
    assert chosen is not None
    assert task is not None
    warnings = tuple(conflicts.conflicts(model.objects, chosen.actuators)) + _lockstep_loss_warnings(config, injected)
    planned = Plan(config, scenario, model, tuple(valid_sources), period, chosen, task, warnings, injected)
    if injected is not None:
        FaultInjection(injected, planned, config.slots)  # so that its errors are reported before anything starts
    return planned


def _dates_are_valid(scenario: Scenario, errors: ErrorCollector) -> bool:
    """Collect the errors of the run period that need no model; return whether there are none."""
    days = [(field, day) for field, day in (("begin", scenario.begin), ("end", scenario.end)) if day is not None]
    valid = [errors.collect(lambda field=field, day=day: parse_day(day, field)) is not None for field, day in days]  # type: ignore[misc]
    steps = scenario.steps_per_hour
    if steps is not None:
        valid.append(errors.collect(lambda: _is_checked(steps)) is not None)
    return all(valid)


def _is_checked(steps_per_hour: int) -> bool:
    check_steps_per_hour(steps_per_hour)
    return True


def _check_output_dir(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InvalidConfig(f"output_dir={folder} is a file; name a folder")


def _lockstep_loss_warnings(config: NodeConfig, faults: FaultPlan | None) -> tuple[str, ...]:
    lost = [fault.name or fault.kind for fault in faults.faults if isinstance(fault, Loss)] if faults else []
    if (
        not lost
        or config.mode is not Mode.LOCKSTEP
        or (config.deadline_s is not None and config.policy is not Policy.WAIT)
    ):
        return ()
    return (
        f"the fault {', '.join(lost)} loses messages, and in lockstep the node then waits forever; "
        "set a deadline and a policy (--deadline 0.5 --policy hold)",
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
    # Default actuators: those that have no effect are left out.
    overridden = conflicts.overridden_actuators(model.objects, chosen.actuators)
    return replace(chosen, actuators=tuple(a for a in chosen.actuators if a.name not in overridden))


def _actuator(model: Building, offered: PointCatalog, name: str, spec: ActuatorSpec) -> list[object]:
    """Return the names and bounds of an actuator; bounds that the scenario leaves out are those of the model."""
    names = [spec.component_type, spec.control_type, spec.key]
    if spec.low is None and spec.high is None:
        return [*names]
    try:
        low, high = selection.actuator_bounds(model, selection.find_actuator(offered, name, *names))
    except UnknownName:
        return [*names]  # `select_points` reports it together with all other unknown names
    return [*names, low if spec.low is None else spec.low, high if spec.high is None else spec.high]
