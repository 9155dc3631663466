"""Find what EnergyPlus does not accept in schedules, special days and daylight saving time, beyond its input schema."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from zenostat.models.building.compact_schedules import compact_findings
from zenostat.models.building.findings import FieldFinding, RuleFinding, finding
from zenostat.models.building.schedule_fields import (
    DAY_MIN,
    LAST_DAY,
    DayTimes,
    DayTypes,
    FieldError,
    check_date,
    date_of,
    day_of_year,
    unknown_day_words,
)
from zenostat.models.building.schedule_files import file_findings
from zenostat.models.input_format.source_model import ModelObjects

_PARTS = ("Schedule:Day:", "Schedule:Week:")


def schedule_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield the findings on the schedules, special days and daylight saving time of a model that matches the schema."""
    for kind, check in _CHECKS.items():
        for name, fields in objects.get(kind, {}).items():
            yield from (finding(kind, name, each) for each in check(fields))
    yield from _repeated_names(objects)


def _repeated_names(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield an error for each schedule whose name one of another type has."""
    first: dict[str, str] = {}
    for kind in (each for each in objects if each.startswith("Schedule:") and not each.startswith(_PARTS)):
        for name in objects[kind]:
            earlier = first.setdefault(name.casefold(), kind)
            if earlier != kind:
                yield finding(
                    kind, name, FieldFinding("", f": a {earlier} has this name, too; schedules need their own")
                )


def _interval_findings(fields: Mapping[str, Any]) -> Iterator[FieldFinding]:
    entries = list(fields.get("data", ()))
    times = DayTimes()
    path, shown = "", "it has no times"
    try:
        for index, entry in enumerate(entries):
            path, time = f"data[{index}].time", str(entry.get("time", ""))
            shown = f"{path} is {time!r}"
            if note := times.add(time):
                yield FieldFinding(path, f": {shown}, but {note}", is_fatal=False)
            if "value_until_time" not in entry:
                path = f"data[{index}].value_until_time"
                yield FieldFinding(path, f": {path}, the value up to {time!r}, is missing")
                return
        times.check_end()
    except FieldError as error:
        yield FieldFinding(path, f": {shown}, {error}")


def _list_findings(fields: Mapping[str, Any]) -> Iterator[FieldFinding]:
    count = len(fields.get("extensions", ()))
    minutes = fields.get("minutes_per_item")
    path = "minutes_per_item" if minutes else ""
    if not minutes:
        text = f": it lacks 'minutes_per_item', the minutes for which each of its {count} values holds"
    elif 60 % int(minutes):
        text = f": minutes_per_item is {minutes}, which does not divide the hour; 15, 30 or 60 do"
    elif count * int(minutes) != DAY_MIN:
        text = (
            f": minutes_per_item is {minutes}, for which a day has {DAY_MIN // int(minutes)} values, but it has {count}"
        )
    else:
        return
    yield FieldFinding(path, text)


def _week_findings(fields: Mapping[str, Any]) -> Iterator[FieldFinding]:
    days = DayTypes()
    for index, entry in enumerate(fields.get("data", ())):
        path, text = f"data[{index}].daytype_list", str(entry.get("daytype_list", ""))
        try:
            days.add(text)
        except FieldError as error:
            yield FieldFinding(path, f": {path} is {text!r}, {error}")
            return
        for note in unknown_day_words(text):
            yield FieldFinding(path, f": {path} is {text!r}, but {note}", is_fatal=False)
    if days.missing:
        text = f": it has no schedule for {', '.join(days.missing)}; 'For: AllOtherDays' stands for the rest"
        yield FieldFinding("", text)


def _year_findings(fields: Mapping[str, Any]) -> Iterator[FieldFinding]:
    counts = [0] * (LAST_DAY + 1)
    for index, entry in enumerate(fields.get("schedule_weeks", ())):
        ends = list[int]()
        for end in ("start", "end"):
            date = f"{entry.get(f'{end}_month', 0)}/{entry.get(f'{end}_day', 0)}"
            path = f"schedule_weeks[{index}].{end}_day"
            try:
                ends.append(day_of_year(date))
            except FieldError:
                yield FieldFinding(path, f": schedule_weeks[{index}] {end}s on {date}, which is no day of the year")
                return
        first, last = ends
        days = range(first, last + 1) if first <= last else [*range(first, LAST_DAY + 1), *range(1, last + 1)]
        for day in days:
            counts[day] += 1
            if counts[day] > 1:
                path = f"schedule_weeks[{index}].start_month"
                text = f": schedule_weeks[{index}] has {date_of(day)}, which an earlier week has already"
                yield FieldFinding(path, text)
                return
    counts[60] = counts[60] or counts[59]
    missing = [day for day in range(1, LAST_DAY + 1) if not counts[day]]
    if missing:
        yield FieldFinding("", f": no week of it has {date_of(missing[0])}; the days of the year must be complete")


def _date_findings(fields: Mapping[str, Any]) -> Iterator[FieldFinding]:
    for path in ("start_date", "end_date"):
        text = str(fields.get(path, ""))
        try:
            check_date(text)
        except FieldError as error:
            has_year = len(re.findall(r"\d+", text)) == 3  # EnergyPlus accepts it
            yield FieldFinding(path, f": {path} is {text!r}, {error}", is_fatal=not has_year)


_CHECKS: dict[str, Callable[[Mapping[str, Any]], Iterator[FieldFinding]]] = {
    "RunPeriodControl:DaylightSavingTime": _date_findings,
    "RunPeriodControl:SpecialDays": _date_findings,
    "Schedule:Compact": compact_findings,
    "Schedule:Day:Interval": _interval_findings,
    "Schedule:Day:List": _list_findings,
    "Schedule:File": file_findings,
    "Schedule:Week:Compact": _week_findings,
    "Schedule:Year": _year_findings,
}
