"""Building models as epJSON: read, convert from IDF where needed, and prepare for one episode."""

from __future__ import annotations

import json
from calendar import isleap
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from zenostat.models import energyplus
from zenostat.models.building import idf, openstudio, output_objects, templates
from zenostat.models.building.diagnostics import Severity, cached_diagnostics, describe, diagnose_unexpanded, verdict
from zenostat.models.building.edits import Edits, apply_edits
from zenostat.models.building.external_files import with_absolute_paths
from zenostat.models.building.run_needs import changed_timesteps, simulation_control
from zenostat.models.building.schedule_fields import DATED, missing_date
from zenostat.models.building.source_lines import read_source
from zenostat.models.building.template_references import is_template
from zenostat.models.catalog import Entry
from zenostat.models.input_format.encoding import check_encoding, decode_epjson, decode_idf
from zenostat.models.input_format.idf_reader import idf_version
from zenostat.models.input_format.source_model import ObjectsOfType
from zenostat.models.run_period import Period, year_of
from zenostat.models.upgrade.files import cached_upgrade
from zenostat.models.upgrade.upgrade import UpgradedModel, upgrade_epjson
from zenostat.models.upgrade.versions import short
from zenostat.topics.cache import cached_bytes, digest
from zenostat.topics.calendar import format_month_day, is_month_day, parse_day
from zenostat.topics.errors import InvalidConfig


@dataclass(frozen=True)
class Building:
    """A building model.

    Attributes:
        name: the catalog's name.
        objects: object type, object name, fields.
        content: digest of its content.
        notes: on its upgrade to the engine's version, and on its templates.
        file: path of the file, for error messages.
        unexpanded: the objects before the templates were expanded; empty without templates.
    """

    name: str
    objects: dict[str, ObjectsOfType]
    content: str
    notes: tuple[str, ...] = ()
    file: str = ""
    unexpanded: dict[str, ObjectsOfType] = field(default_factory=dict)

    def find(self, kind: str, name: str) -> dict[str, Any]:
        """Return an object's fields by type and name, both in any case; empty if there is none."""
        return self._by_name.get((kind.casefold(), name.casefold()), {})

    @cached_property
    def _by_name(self) -> dict[tuple[str, str], dict[str, Any]]:
        objects = [(kind, name, fields) for kind, named in self.objects.items() for name, fields in named.items()]
        return {(kind.casefold(), name.casefold()): fields for kind, name, fields in reversed(objects)}

    @property
    def run_period(self) -> dict[str, Any]:
        """Fields of the model's first run period; empty if it has none."""
        return dict(next(iter(self.objects.get("RunPeriod", {}).values()), {}))

    @property
    def steps_per_hour(self) -> int:
        """The model's own number of timesteps per hour; without one as in EnergyPlus: 4, of an empty Timestep 6."""
        timestep = next(iter(self.objects.get("Timestep", {}).values()), None)
        return 4 if timestep is None else int(timestep.get("number_of_timesteps_per_hour", 6))

    def period(self, begin: str | None, end: str | None, steps_per_hour: int | None) -> Period:
        """Return the requested run period, in the model's own calendar year if none is given.

        An end without a year is in the year of the begin, or in the next one if the model's own period goes over New
        Year.
        """
        own = self.run_period
        month, day = int(own.get("begin_month", 1)), int(own.get("begin_day_of_month", 1))
        last_month, last_day = int(own.get("end_month", 12)), int(own.get("end_day_of_month", 31))
        year = int(own.get("begin_year") or year_of(month, day, own.get("day_of_week_for_start_day")))
        if begin is None or end is None:
            self._check_own_days()
        if steps_per_hour is None:
            self._check_own_timestep()
            steps_per_hour = self.steps_per_hour
        self._check_timesteps(steps_per_hour)
        first = parse_day(begin or f"{month}-{day}", "begin", year)
        over_new_year = (last_month, last_day) < (month, day)
        if end is None and begin is None:
            last_year = int(own.get("end_year") or year + over_new_year)
            self._check_own_years((year, month, day), (last_year, last_month, last_day))
            end = f"{last_year:04}-{last_month}-{last_day}"
        own_years = [int(own.get(f"{side}_year") or 0) for side in ("begin", "end")]
        if end is None and own_years[0] and own_years[0] <= first.year < own_years[1]:  # it goes over several years
            end = f"{own_years[1]:04}-{last_month}-{last_day}"
        end = end or f"{last_month}-{last_day}"
        last = parse_day(end, "end", first.year)
        if over_new_year and last < first:
            last = parse_day(end, "end", first.year + 1)  # the same day if it has a year
        by_year = str(self.run_period.get("treat_weather_as_actual")).casefold() == "yes"
        self._check_special_days(first.year)
        return Period(first, last, steps_per_hour, by_year)

    def _check_own_days(self) -> None:
        """Check the days of the model's own run period."""
        own = self.run_period
        for end, default in (("begin", (1, 1)), ("end", (12, 31))):
            month, day = int(own.get(f"{end}_month", default[0])), int(own.get(f"{end}_day_of_month", default[1]))
            if not is_month_day(month, day):
                text = f"{end}s on {format_month_day(month, day)}, which is no day"
                raise self._run_period_error(f"{end}_day_of_month", text)

    def _check_own_years(self, begin: tuple[int, int, int], end: tuple[int, int, int]) -> None:
        """Check the years of the model's own run period, given or derived, with its days as (year, month, day)."""
        for side, (year, month, day) in (("begin", begin), ("end", end)):
            if (month, day) == (2, 29) and not isleap(year):
                raise self._run_period_error(f"{side}_year", f"{side}s on 02-29, which {year} does not have")
        if end < begin:
            missing = "" if self.run_period.get("begin_year") else " (it has no begin_year)"
            raise self._run_period_error("end_year", f"ends in {end[0]}, but begins in {begin[0]}{missing}")

    def _check_special_days(self, year: int) -> None:
        """Check that the year of the run period has the dates of special days and of daylight saving time.

        Whether EnergyPlus counts the 29 February of a leap year depends on the weather file; it decides itself.
        """
        if isleap(year):
            return
        for kind in DATED:
            for name, fields in self.objects.get(kind, {}).items():
                if end := missing_date(fields, year):
                    raise InvalidConfig(
                        f"{kind} {name!r} of {self._place(kind, name, end)} has {end} {fields[end]!r}, which {year} "
                        "does not have; choose a run period in another year, or the last such weekday, as in 'Last "
                        "Sunday in March'"
                    )

    def _run_period_error(self, field: str, text: str) -> InvalidConfig:
        """Return an error of the model's own run period."""
        name = next(iter(self.objects.get("RunPeriod", {})))
        place = self._place("RunPeriod", name, field)
        return InvalidConfig(f"RunPeriod {name!r} of {place} {text}; correct it, or choose begin and end")

    def _check_own_timestep(self) -> None:
        """Check the number of timesteps of the model itself, which EnergyPlus would change."""
        if 60 % self.steps_per_hour:
            name = next(iter(self.objects.get("Timestep", {})))
            place = self._place("Timestep", name, "number_of_timesteps_per_hour")
            raise InvalidConfig(
                f"Timestep {name!r} of {place} has number_of_timesteps_per_hour {self.steps_per_hour}, which does not "
                "divide the hour; 4, 6, 10 or 12 do; correct it, or choose steps_per_hour"
            )

    def _check_timesteps(self, steps_per_hour: int) -> None:
        """Check that EnergyPlus takes as many timesteps per hour as it is asked for."""
        if change := changed_timesteps(self.objects, steps_per_hour):
            kind, name, field, steps = change
            value = self.objects[kind][name][field]
            raise InvalidConfig(
                f"{kind} {name!r} of {self._place(kind, name, field)} has {field} {value!r}, with which EnergyPlus "
                f"takes {steps} instead of {steps_per_hour} timesteps per hour; set steps_per_hour to {steps}, or "
                f"change {field}"
            )

    def _place(self, kind: str, name: str, field: str) -> str:
        """Return the model's file, with the line of a field if it is known."""
        line = read_source(Path(self.file)).line(kind, name, field) if self.file else None
        return f"{self.file or self.name}, line {line}," if line else self.file or self.name


def read_building(entry: Entry) -> Building:
    """Read the model of a catalog entry for the installed engine.

    An IDF is converted once per content and engine version. A model of an earlier version is upgraded, and templates
    are expanded. OpenStudio translates its own models and gbXML to IDF. Files that its objects name are those in the
    folder of the model.

    Raises:
        InvalidConfig: the file has errors (the text lists them with their lines), the model cannot be upgraded, a
            template cannot be expanded, or OpenStudio is needed and not installed.
        ModelError: EnergyPlus cannot read the IDF, or ExpandObjects failed.
    """
    raw = entry.path.read_bytes()
    content = digest(raw, energyplus.version())
    translation, suffix = tuple[str, ...](), entry.path.suffix.lower()
    if suffix in openstudio.SUFFIXES:
        translated = openstudio.translate(entry.path)
        translation, content = translated.notes, digest(translated.idf, energyplus.version())
        raw = cached_bytes(
            f"models/{content}-translated.epJSON", lambda target: idf.convert_text(translated.idf, target, entry.path)
        )
    if suffix == ".idf":
        upgraded = _read_idf(entry.path, raw, content)
    else:
        text = decode_epjson(raw, entry.path)
        upgraded = upgrade_epjson(_parse_epjson(text, entry.path), name=entry.path.name, text=text)
    if "Building" not in upgraded.objects:
        raise InvalidConfig(f"{entry.path} is not a building model: it has no 'Building' object")
    expanded, notes = _expand(upgraded.objects, entry.path)
    summary = (upgraded.summary,) if upgraded.summary else ()
    unexpanded = upgraded.objects if notes else {}
    objects = with_absolute_paths(expanded, entry.path.parent)
    return Building(entry.name, objects, content, (*translation, *summary, *notes), str(entry.path), unexpanded)


def _expand(objects: dict[str, ObjectsOfType], path: Path) -> tuple[dict[str, ObjectsOfType], tuple[str, ...]]:
    """Return `templates.expand` of a file's objects; its errors begin with those of the templates' fields.

    ExpandObjects itself names no field, and not every object.
    """
    try:
        return templates.expand(objects, file=str(path))
    except InvalidConfig as error:
        if errors := diagnose_unexpanded(objects, read_source(path)):
            reason = str(error).partition("\n")[2]
            raise InvalidConfig(f"{describe(errors, str(path), verdict())}\n{reason}".rstrip()) from None
        raise


def _read_idf(path: Path, raw: bytes, content: str) -> UpgradedModel:
    """Read an IDF of any known version.

    EnergyPlus's own converter reads those of its version, unless they have templates, which it refuses.
    """
    check_encoding(raw, path)
    text = decode_idf(raw)
    version = idf_version(text)
    is_own = version in (None, "") or short(version) == short(energyplus.version())
    if not is_own or "hvactemplate:" in text.casefold():
        return cached_upgrade(text, name=path.name)
    converted = cached_bytes(f"models/{content}.epJSON", lambda target: idf.convert(path, target))
    return upgrade_epjson(_parse_epjson(decode_epjson(converted, path), path), name=path.name)


def _parse_epjson(text: str, path: Path) -> dict[str, Any]:
    try:
        objects = json.loads(text)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise InvalidConfig(f"{path} is not an epJSON file: {place}: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise InvalidConfig(f"{path} is not an epJSON file: {error}") from None
    if not isinstance(objects, dict) or "Building" not in objects:
        raise InvalidConfig(f"{path} is not a building model: it has no 'Building' object")
    return objects


def check_runnable(building: Building) -> None:
    """Check that EnergyPlus can read a model, and that it runs no other program within the simulation.

    Raises:
        InvalidConfig: lists all errors, with object, field and line.
    """
    file = building.file or building.name
    errors = [each for each in cached_diagnostics(building) if each.severity is Severity.ERROR]
    if errors:
        raise InvalidConfig(describe(errors, file, verdict()))


def with_edits(building: Building, edits: Edits) -> Building:
    """Return the building with a scenario's edits applied; files that they name are those in the folder of the model.

    Those of templates are applied first, and the templates are expanded again.

    Raises:
        InvalidConfig: lists all errors of the edits; or a template cannot be expanded.
    """
    if not edits:
        return building
    of_templates = {kind: items for kind, items in edits.items() if is_template(kind)}
    if of_templates:
        building = _with_other_templates(building, of_templates)
    objects = apply_edits(building.objects, {kind: items for kind, items in edits.items() if kind not in of_templates})
    return replace(
        building,
        objects=with_absolute_paths(objects, Path(building.file).parent) if building.file else objects,
        content=digest(building.content, json.dumps(edits, sort_keys=True)),
    )


def _with_other_templates(building: Building, edits: Edits) -> Building:
    """Return the building with edited templates, expanded anew."""
    path, unexpanded = Path(building.file or building.name), building.unexpanded
    former = _expand(unexpanded, path)[1] if unexpanded else ()
    edited = apply_edits(unexpanded or building.objects, edits)
    objects, notes = _expand(edited, path)
    kept = tuple(note for note in building.notes if note not in former)
    return replace(building, objects=objects, notes=(*kept, *notes), unexpanded=edited if notes else {})


def for_episode(
    building: Building, period: Period, *, outputs: bool = False, requested: Iterable[tuple[str, str]] = ()
) -> dict[str, ObjectsOfType]:
    """Return the objects for one episode: its run period and timestep, without design-day environments.

    Objects that act on the building are unchanged.

    Args:
        building: the model.
        period: the run period.
        outputs: whether to keep the model's output objects; otherwise EnergyPlus writes only its errors.
        requested: name and key of the output variables to compute that EnergyPlus computes only on request.
    """
    objects = {kind: copy(items) for kind, items in building.objects.items()}
    if not outputs:
        objects = output_objects.without_files(objects)
    objects = output_objects.with_requests(objects, requested)
    own = {k: v for k, v in building.run_period.items() if k != "day_of_week_for_start_day"}
    objects["RunPeriod"] = {
        "zenostat": own
        | {
            "begin_month": period.begin.month,
            "begin_day_of_month": period.begin.day,
            "begin_year": period.begin.year,
            "end_month": period.end.month,
            "end_day_of_month": period.end.day,
            "end_year": period.end.year,
        }
    }
    objects["Timestep"] = {"zenostat": {"number_of_timesteps_per_hour": period.steps_per_hour}}
    objects["SimulationControl"] = {"zenostat": simulation_control(objects)}
    return objects


def write(objects: dict[str, ObjectsOfType], folder: Path) -> Path:
    """Write `in.epJSON` into `folder` and return its path."""
    path = folder / "in.epJSON"
    path.write_text(json.dumps(objects))
    return path
