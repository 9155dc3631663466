"""Check the settings of a node before anything starts: building, weather, run period, points, task, faults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zenostat.bridge.alarms.rules import point_alarms, read_rules
from zenostat.bridge.faults import read_plan
from zenostat.bridge.node.fault_injection import FaultInjection
from zenostat.bridge.node.manifest import described_manifest
from zenostat.bridge.node.plant import PlantDescription, Provenance, RunPeriod
from zenostat.eplus_node.config import NodeConfig, scenario_of
from zenostat.models import catalog, energyplus
from zenostat.models.building import conflicts, output_objects, schematic
from zenostat.models.building import model as building
from zenostat.models.building.external_files import files_by_role
from zenostat.models.building.geometry import BuildingGeometry, building_geometry
from zenostat.models.building.model import Building
from zenostat.models.building.run_needs import assumptions, lacks_design_days
from zenostat.models.building.summary import floor_area_m2
from zenostat.models.building.whole_weather import reads_whole_weather
from zenostat.models.points import discovery, selection
from zenostat.models.points.discovery import PointCatalog
from zenostat.models.points.monitoring import with_monitoring, with_systems, with_unobserved
from zenostat.models.points.schedules import with_baseline_sensors, with_leads
from zenostat.models.points.selection import Points
from zenostat.models.run_period import Period, check_steps_per_hour
from zenostat.models.scenario.episode_weather import NOISE_FREE_DAYS, WeatherSource, check_years, first_noisy_row
from zenostat.models.scenario.schema import ActuatorSpec, Scenario, dump
from zenostat.models.scenario.task import relative_actuators, task_of
from zenostat.models.semantic.graph import semantic_turtle
from zenostat.models.weather import design_days, epw, noise
from zenostat.models.weather.header import check_complete, check_covers, read_header
from zenostat.models.weather.records import check_records, missing_values
from zenostat.topics import VERSION
from zenostat.topics.calendar import parse_day
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownName
from zenostat.topics.fault_plan import FaultPlan, Loss
from zenostat.topics.messages import Aggregation, Manifest, Mode, Policy, Systems, Task, Versions
from zenostat.topics.plurals import counted

REPEATED_SETTINGS = ("shrink_caches", "monitoring", "systems", "building", "weather")
"""Settings of a provenance. A recording is data of anybody: no other setting of a node may come from one."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked configuration: everything that can be determined before EnergyPlus runs.

    Attributes:
        warnings: objects of the model that override the scenario's actuators, surfaces that cannot be drawn, a missing
            run period, and faults that would block the node.
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
    geometry: BuildingGeometry
    systems: Systems
    faults: FaultPlan | None = None


def plan(config: NodeConfig, check_task: Callable[[Manifest], None] | None = None) -> Plan:
    """Find and check the scenario: building, edits, weather, run period, points, task.

    Args:
        config: settings of the node.
        check_task: also called with a manifest that has the points and the task, as soon as these are known; its errors
            are listed with the others.

    Raises:
        UnknownName: no such scenario, building, weather or point.
        InvalidConfig: invalid settings.
        ModelError: EnergyPlus cannot read the model.
    """
    errors = ErrorCollector()
    scenario = scenario_of(config, errors)
    incomplete = bool(errors.errors)  # a missing or wrong name is an empty one, and an error already
    model = None if incomplete and not scenario.building else _read_model(scenario, errors)
    names = [name for name in scenario.weather if name or not incomplete]
    sources = tuple(errors.collect(lambda name=name: _source(name, scenario)) for name in names)  # type: ignore[misc]
    errors.collect(lambda: noise.resolve_columns(scenario.weather_noise))
    errors.collect(lambda: _check_output(config.output_dir, scenario))
    period = chosen = task = None
    if _dates_are_valid(scenario, errors) and model is not None:
        period = errors.collect(lambda: model.period(scenario.begin, scenario.end, scenario.steps_per_hour))
    valid_sources = [source for source in sources if source is not None]
    before = len(errors.errors)
    _check_weather(valid_sources, period, errors)
    covered = period if len(errors.errors) == before else None
    if period is not None:
        errors.collect(lambda: _check_noise_start(scenario, model, period, valid_sources))
    errors.collect(lambda: design_days.check_edits(scenario.edits, [source.site for source in valid_sources]))
    if model is not None:
        errors.collect(lambda: _check_sizing(model, valid_sources))
    if model is not None and valid_sources:
        chosen = errors.collect(
            lambda: run_points(
                model, scenario, valid_sources[0].path, covered, monitoring=config.monitoring, systems=config.systems
            )
        )
    if chosen is not None:
        task = errors.collect(lambda: task_of(scenario, chosen))
        has_all_points = covered is not None or scenario.relative is None  # its sensors follow schedules of the period
        if check_task is not None and model is not None and period is not None and task is not None and has_all_points:
            manifest = _manifest(config, model, valid_sources[0], period, chosen, task)
            errors.collect(lambda: check_task(manifest))
    file = config.faults
    injected = errors.collect(lambda: read_plan(file)) if file is not None else None
    rules_file = config.alarms
    rules = errors.collect(lambda: read_rules(rules_file)) if rules_file is not None else None
    errors.raise_if_any()
    assert model is not None
    assert period is not None
    assert chosen is not None
    assert task is not None
    geometry = building_geometry(model, valid_sources[0].header)
    warnings = (
        *conflicts.conflicts(model.objects, chosen.actuators),
        *([geometry.note] if geometry.note else []),
        *assumptions(model.objects, has_dates=scenario.begin is not None or scenario.end is not None),
        *(note for source in valid_sources for note in missing_values(source.path, source.name)),
        *_lockstep_loss_warnings(config, injected),
    )
    if not isinstance(config.environment_reward, str):
        scenario = scenario.model_copy(update={"reward": config.environment_reward})
    described = schematic.systems(model.objects)
    planned = Plan(
        config, scenario, model, tuple(valid_sources), period, chosen, task, warnings, geometry, described, injected
    )
    if injected is not None:
        FaultInjection(
            injected, describe(planned), config.slots
        )  # so that its errors are reported before anything starts
    if rules is not None:
        point_alarms(rules, describe(planned))
    return planned


def _check_weather(sources: Sequence[WeatherSource], period: Period | None, errors: ErrorCollector) -> None:
    for source in sources:
        is_complete = errors.collect(lambda source=source: _is_complete(source))  # type: ignore[misc]
        if is_complete:
            errors.collect(lambda source=source: check_records(source.header, source.path))  # type: ignore[misc]
        if period is not None:
            errors.collect(lambda source=source: check_covers(source.header, period, source.name))  # type: ignore[misc]
            if is_complete:
                errors.collect(lambda source=source: check_years(source.path, source.name, period))  # type: ignore[misc]


def _is_complete(source: WeatherSource) -> bool:
    check_complete(source.header, source.path)
    return True


def _manifest(
    config: NodeConfig, model: Building, source: WeatherSource, period: Period, points: Points, task: Task
) -> Manifest:
    """Return what a node of this plan would publish, as far as an agent's part depends on it."""
    description = PlantDescription(
        name=model.name,
        run_period=RunPeriod(period.time(0), period.step_s, period.steps),
        sensors=points.sensors,
        meters=points.meters,
        actuators=points.actuators,
        versions=Versions(zenostat=VERSION, energyplus=energyplus.version()),
        task=task,
    )
    header = source.header
    return described_manifest(config, description, latitude_deg=header.latitude_deg, longitude_deg=header.longitude_deg)


def describe(plan: Plan) -> PlantDescription:
    """Describe the building, its points and its task for the node."""
    period, points = plan.period, plan.points
    return PlantDescription(
        name=plan.building.name,
        run_period=RunPeriod(period.time(0), period.step_s, period.steps),
        sensors=points.sensors,
        meters=points.meters,
        actuators=points.actuators,
        versions=Versions(zenostat=VERSION, energyplus=energyplus.version()),
        task=plan.task,
        scenario=dump(plan.scenario),
        warnings=plan.warnings,
        zones=tuple(plan.building.objects.get("Zone", {})),
        floor_area_m2=floor_area_m2(plan.building),
        geometry=plan.geometry.geometry,
        systems=plan.systems,
        without_geometry=plan.geometry.note,
        semantic=lambda node: semantic_turtle(plan.building, node, points),
        provenance=_provenance(plan),
    )


def input_files(config: NodeConfig) -> dict[str, Path]:
    """Return the files that determine the results besides the scenario's text, by role; reads no model or weather.

    Those that the model names are not among them; a plan's provenance has them as well.

    Raises:
        UnknownName, InvalidConfig: there is no such scenario, building or weather, or a setting is invalid.
    """
    scenario = scenario_of(config)
    weathers = [catalog.find_weather(name).path for name in scenario.weather]
    return _files(catalog.find_building(scenario.building).path, weathers, scenario)


def _files(model: Path | None, weathers: Sequence[Path], scenario: Scenario) -> dict[str, Path]:
    """Return model, weather files, design days and engine by role."""
    files = {"model": model} if model is not None else {}
    for number, weather in enumerate(weathers, 1):
        files[f"weather {number}"] = weather
        ddy = design_days.ddy_of(weather)
        if scenario.sizing == "weather" and ddy is not None:
            files[f"design days {number}"] = ddy
    return files | {"engine": energyplus.library()}


def _provenance(plan: Plan) -> Provenance:
    """Describe how to create the plant again; see `REPEATED_SETTINGS` for its settings."""
    model = Path(plan.building.file) if plan.building.file else None
    files = _files(model, [source.path for source in plan.sources], plan.scenario)
    files |= files_by_role(plan.building.objects)
    config = plan.config
    settings: dict[str, object] = {"shrink_caches": config.shrink_caches, "monitoring": config.monitoring}
    if config.systems:
        settings["systems"] = True
    # A path in the scenario may be relative to the node's working directory.
    if Path(plan.scenario.building).suffix.lower() in catalog.MODEL_SUFFIXES:
        settings["building"] = str(files["model"].absolute())
    if any(Path(name).suffix.lower() in catalog.WEATHER_SUFFIXES for name in plan.scenario.weather):
        settings["weather"] = [str(source.path.absolute()) for source in plan.sources]
    return Provenance("energyplus", settings, files)


def _read_model(scenario: Scenario, errors: ErrorCollector) -> Building | None:
    """Read and edit the model; if only the edits fail, return the unedited model, which serves to check the rest."""
    plain = errors.collect(lambda: building.read_building(catalog.find_building(scenario.building)))
    if plain is None:
        return None
    return errors.collect(lambda: building.with_edits(plain, scenario.edits)) or plain


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


def _check_noise_start(
    scenario: Scenario, model: Building | None, period: Period, sources: Sequence[WeatherSource]
) -> None:
    """Check that noise from the third day on leaves what EnergyPlus computes before it as it is."""
    if not scenario.weather_noise or scenario.noise_start == "episode" or model is None:
        return
    days = (period.end - period.begin).days + 1
    if days <= NOISE_FREE_DAYS:
        raise InvalidConfig(
            f"noise_start: third_day needs a run period of at least {NOISE_FREE_DAYS + 1} days; this one has "
            f"{counted(days, 'day')}, and they would have no noise"
        )
    reader = reads_whole_weather(model.objects)
    if reader:
        raise InvalidConfig(
            f"noise_start: third_day is not possible with {model.name}: its {reader} reads the whole weather file "
            "before the episode starts; use noise_start: episode"
        )
    for source in sources:
        first_noisy_row(epw.read(source.path), period)


def _check_output(output_dir: Path | None, scenario: Scenario) -> None:
    """Check the folder of EnergyPlus's output files; without one, no edit may ask for such files."""
    if output_dir is None:
        output_objects.check_edits(scenario.edits)
    else:
        _check_output_dir(output_dir)


def _check_output_dir(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InvalidConfig(f"output_dir={folder} is a file; name a folder")


def _check_sizing(model: Building, sources: Sequence[WeatherSource]) -> None:
    """Check that a model that is sized has design days, of its own or of the weather."""
    if not lacks_design_days(model.objects):
        return
    for source in sources:
        if source.site is None or not source.site.design_days:
            reason = "the scenario has sizing: model" if source.site is None else f"{source.name} has none either"
            raise InvalidConfig(
                f"{model.file or model.name} requests sizing (SimulationControl), but has no design days "
                f"(SizingPeriod:DesignDay), and {reason}; add some, or use a weather file with design conditions or a "
                "DDY file beside it, and sizing: weather"
            )


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


def run_points(
    model: Building,
    scenario: Scenario,
    any_weather: Path,
    period: Period | None = None,
    *,
    monitoring: bool,
    systems: bool = False,
) -> Points:
    """Return the points of a scenario's run.

    Args:
        model: the scenario's model, edited.
        scenario: what is measured and controlled; by default the model's default points.
        any_weather: a weather file, to start EnergyPlus.
        period: the run period, which the weather file covers; without it, no schedules are known beforehand.
        monitoring: whether to add the points for pictures and reports.
        systems: whether to add the points for a schematic of the loops.

    Raises:
        UnknownName, InvalidConfig: the points of the scenario have errors.
        ModelError: EnergyPlus cannot start the model.
    """
    offered, paired = discovery.discover(model, any_weather), scenario.control == "building"
    actuators = None
    if scenario.actuators is not None:
        actuators = {
            name: _actuator(model, offered, name, spec, paired=paired) for name, spec in scenario.actuators.items()
        }
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
    chosen = selection.select_points(model, offered, specs, scenario.meters, actuators, paired=paired)
    if actuators is None:  # those that have no effect are left out
        overridden = conflicts.overridden_actuators(model.objects, chosen.actuators)
        chosen = replace(chosen, actuators=tuple(a for a in chosen.actuators if a.name not in overridden))
    if period is not None:
        chosen = _with_schedules(model, scenario, any_weather, period, chosen)
    chosen = with_unobserved(chosen, scenario.unobserved)
    if monitoring:
        chosen = with_monitoring(model, offered, chosen)
    return with_systems(model, offered, chosen) if systems else chosen


def _with_schedules(model: Building, scenario: Scenario, any_weather: Path, period: Period, points: Points) -> Points:
    """Return the points with the schedules that are known beforehand: sensors with a lead, and relative actuators."""
    leads = {name: spec.lead_h for name, spec in (scenario.sensors or {}).items() if spec.lead_h is not None}
    if leads:
        points = with_leads(points, leads, model, period)
    relative = relative_actuators(scenario, points.actuators) if scenario.relative is not None else []
    fixed = [name for name, spec in (scenario.actuators or {}).items() if spec.low is not None or spec.high is not None]
    return with_baseline_sensors(points, relative, fixed, model, period, any_weather) if relative else points


def _actuator(model: Building, offered: PointCatalog, name: str, spec: ActuatorSpec, *, paired: bool) -> list[object]:
    """Return the names and bounds of an actuator; bounds that the scenario leaves out are those of the model."""
    names = [spec.component_type, spec.control_type, spec.key]
    if spec.low is None and spec.high is None:
        return [*names]
    try:
        low, high = selection.actuator_bounds(model, selection.find_actuator(offered, name, *names), paired=paired)
    except UnknownName:
        return [*names]  # `select_points` reports it together with all other unknown names
    return [*names, low if spec.low is None else spec.low, high if spec.high is None else spec.high]
