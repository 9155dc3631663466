"""`zenostat alarms`: the alarms of a running node."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from typing import Annotated, Any

import typer
from rich.live import Live

from zenostat.cli.console import err, out
from zenostat.cli.options import DEFAULTS, BusOptions, Node, Slot, on_bus
from zenostat.cli.tables import fitted, show, show_json
from zenostat.topics.errors import NodeNotFound
from zenostat.topics.json_numbers import finite
from zenostat.topics.keys import Role
from zenostat.topics.messages import AlarmList, AlarmPriority, AlarmState, AlarmStatus, EventState
from zenostat.topics.printable import replace_controls
from zenostat.topics.units import with_unit

_POLL_S = 1.0
_SET_ASIDE = (AlarmState.SHELVED, AlarmState.OUT_OF_SERVICE, AlarmState.SUPPRESSED)
_ORDER = (AlarmState.ACTIVE, AlarmState.RETURNED, AlarmState.ACKNOWLEDGED, *_SET_ASIDE, AlarmState.NORMAL)
_WRAPPED = ("alarm", "state")
_COLUMNS = ("state", "priority", "alarm", "value", "limit", "since")


@on_bus
def alarms(
    node: Node,
    show_all: Annotated[bool, typer.Option("--all", help="Also list alarms that are normal.")] = False,
    follow: Annotated[bool, typer.Option("--follow", help="Show changes until Ctrl-C.")] = False,
    slot: Slot = 0,
    options: BusOptions = DEFAULTS,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON; with --follow, a line per change.")] = False,
) -> None:
    """List the alarms of a node that are not normal, the most urgent first, and those that are set aside.

    With keys, it uses the monitor role.

    Example: `zenostat alarms office --all`
    """
    with options.open_bus(Role.MONITOR) as bus:
        if follow:
            _follow(lambda: bus.alarms(node, slot=slot), node, show_all=show_all, as_json=as_json)
            return
        listed = bus.alarms(node, slot=slot)
    if as_json:
        show_json(_as_json(node, listed, show_all=show_all))
        return
    if not _selected(listed, show_all=show_all):
        out.print(_title(node, listed))
        return
    show(_title(node, listed), _COLUMNS, _rows(listed, show_all=show_all), right=("value",), wrap=_WRAPPED)


def _follow(read: Callable[[], AlarmList], node: str, *, show_all: bool, as_json: bool) -> None:
    """Show the alarms once per second: in a terminal as a table, otherwise a line for each alarm that has changed."""
    try:
        if out.is_terminal and not as_json:
            with Live(console=out, auto_refresh=False) as live:
                for listed in _polled(read):
                    rows = _rows(listed, show_all=show_all)
                    table = fitted(
                        _COLUMNS, rows, out.width, title=_title(node, listed), right=("value",), wrap=_WRAPPED
                    )
                    live.update(table, refresh=True)
            return
        known: dict[str, AlarmStatus] = {}
        for listed in _polled(read):
            _print_changes(node, listed, known, show_all=show_all, as_json=as_json)
    except NodeNotFound as error:
        err.print(str(error))
    except KeyboardInterrupt:  # the usual way to stop
        return


def _polled(read: Callable[[], AlarmList]) -> Iterator[AlarmList]:
    while True:
        yield read()
        time.sleep(_POLL_S)


def _print_changes(
    node: str, listed: AlarmList, known: dict[str, AlarmStatus], *, show_all: bool, as_json: bool
) -> None:
    for alarm in listed.alarms:
        before = known.get(alarm.alarm)
        known[alarm.alarm] = alarm
        if before is None and alarm.state is AlarmState.NORMAL and not show_all:
            continue
        if before is not None and _change_of(before) == _change_of(alarm):
            continue
        line = json.dumps(finite(_alarm_json(alarm))) if as_json else "  ".join(filter(None, _cells(alarm)))
        sys.stdout.write(f"{line}\n" if as_json else f"{node}  {replace_controls(line)}\n")
        sys.stdout.flush()


def _change_of(alarm: AlarmStatus) -> tuple[Any, ...]:
    return alarm.state, alarm.event_state, alarm.changed, alarm.times_raised, alarm.acknowledged, alarm.set_aside_until


def _selected(listed: AlarmList, *, show_all: bool) -> Sequence[AlarmStatus]:
    """Return the alarms to show: unacknowledged ones first, then by priority, then in the order of the rules."""
    priorities = [*AlarmPriority]
    shown = [alarm for alarm in listed.alarms if show_all or alarm.state is not AlarmState.NORMAL]
    return sorted(shown, key=lambda alarm: (_ORDER.index(alarm.state), priorities.index(alarm.priority)))


def _title(node: str, listed: AlarmList) -> str:
    where = f"{node}, slot {listed.slot}," if listed.slot else node
    if not listed.alarms:
        return f"{where} has no alarms; `zenostat node --alarms FILE` gives a node some"
    count = [sum(alarm.state is state for alarm in listed.alarms) for state in _ORDER]
    parts = [f"{number} {_words(state)}" for number, state in zip(count, _ORDER, strict=True) if number]
    return f"{where} at {listed.time}: {', '.join(parts)}"


def _rows(listed: AlarmList, *, show_all: bool) -> list[tuple[str, ...]]:
    return [_cells(alarm) for alarm in _selected(listed, show_all=show_all)]


def _cells(alarm: AlarmStatus) -> tuple[str, ...]:
    name = alarm.alarm if alarm.point in alarm.alarm else f"{alarm.alarm}: {alarm.point}"
    return (
        _state(alarm),
        str(alarm.priority),
        f"{name}\n{alarm.text}" if alarm.text and out.is_terminal else name,
        "missing" if alarm.value is None else with_unit(f"{alarm.value:.5g}", alarm.unit),
        _limits(alarm),
        _moment(alarm.set_aside or (alarm.changed if alarm.state is AlarmState.NORMAL else alarm.raised)),
    )


def _state(alarm: AlarmStatus) -> str:
    """Describe a state: `active, high limit`, `shelved until 07-03 10:00 by ann: being repaired, high limit`."""
    parts = [_words(alarm.state)]
    if alarm.set_aside:
        until = f"until {_moment(alarm.set_aside_until)}" if alarm.set_aside_until else ""
        by = f"by {alarm.set_aside_by}" if alarm.set_aside_by else ""
        decision = " ".join(filter(None, (until, by)))
        parts[0] += (f" {decision}" if decision else "") + (
            f": {alarm.set_aside_comment}" if alarm.set_aside_comment else ""
        )
    if alarm.event_state is not EventState.NORMAL:
        parts.append(_words(alarm.event_state))
    if alarm.inhibited:
        parts.append("inhibited")
    if alarm.acknowledged and alarm.state is AlarmState.ACKNOWLEDGED:
        by = f"by {alarm.acknowledged_by} " if alarm.acknowledged_by else ""
        parts.append(f"{by}at {_moment(alarm.acknowledged)}" + (f": {alarm.comment}" if alarm.comment else ""))
    return ", ".join(parts)


def _words(state: AlarmState | EventState) -> str:
    return state.replace("_", " ")


def _moment(time: str) -> str:
    """Return a simulated time without the year, which is that of the title."""
    return f"{datetime.fromisoformat(time):%m-%d %H:%M}" if time else ""


def _limits(alarm: AlarmStatus) -> str:
    """Return the normal range, or the limit that is exceeded."""
    low, high = alarm.low, alarm.high
    if alarm.event_state is EventState.HIGH_LIMIT or low is None:
        return with_unit(f"{high:g}", alarm.unit)
    if alarm.event_state is EventState.LOW_LIMIT or high is None:
        return with_unit(f"{low:g}", alarm.unit)
    return with_unit(f"{low:g} to {high:g}", alarm.unit)


def _as_json(node: str, listed: AlarmList, *, show_all: bool) -> dict[str, Any]:
    where = {"node": node, "slot": listed.slot, "episode": listed.episode, "step": listed.step, "time": listed.time}
    return {**where, "alarms": [_alarm_json(alarm) for alarm in _selected(listed, show_all=show_all)]}


def _alarm_json(alarm: AlarmStatus) -> dict[str, Any]:
    return alarm.model_dump(mode="json")
