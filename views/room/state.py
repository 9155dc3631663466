"""A node's state for the page: its status, its latest sample, its alarms, and a summary for the list of nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

from zenostat.bridge.client.sample import SampleView
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import AlarmList, AlarmState, AlarmStatus, ControllerStatus, LatencySummary, Status
from zenostat.views.display.colors import comfort_color, hex_color
from zenostat.views.room.description import NodeDescription
from zenostat.views.room.numbers import number, numbers

OPEN_STATES = (AlarmState.ACTIVE, AlarmState.RETURNED)
"""States in which an alarm awaits an acknowledgment."""


def node_state(
    description: NodeDescription,
    status: Status,
    sample: SampleView | None,
    alarms: AlarmList | None,
    faults: FaultPlan | None = None,
) -> dict[str, Any]:
    """Return the state of slot 0 of a node that is on the bus; `faults`: its fault plan, if it is known."""
    state = {
        **_status(status),
        "instance": description.manifest.instance,
        "alarms": [_alarm(alarm) for alarm in alarms.alarms] if alarms is not None else [],
        "fault_plan": {"faults": []} if faults is None else fault_fields(faults),
    }
    return state if sample is None else state | _sample(description, sample)


def fault_fields(plan: FaultPlan) -> dict[str, Any]:
    """Return the fields of a plan that differ from their defaults, without who set it."""
    fields = plan.model_dump(mode="json", exclude_defaults=True, exclude={"source"})
    return {"faults": []} | fields


def _status(status: Status) -> dict[str, Any]:
    return {
        "node": status.node,
        "online": True,
        "state": status.state,
        "mode": status.mode,
        "speed": status.speed,
        "paused": status.paused,
        "policy": status.policy,
        "episode": status.episode[0],
        "step": status.step[0],
        "time": status.time[0],
        "failure": status.failure,
        "controllers": [_controller(controller) for controller in status.controllers],
        "counts": {name: getattr(status, name) for name in ("accepted", "rejected", "late", "duplicate")},
        "step_time": _latency(status.statistics.step),
        "overruns": status.statistics.overruns,
        "max_lag_s": number(status.statistics.max_lag_s),
        "memory_bytes": status.node_rss_bytes + status.engine_rss_bytes,
        "faults": list(status.faults),
        "branches": [branch.name for branch in status.branches],
        "recording": None
        if status.recording is None
        else status.recording.model_dump(mode="json", include={"path", "state", "messages", "bytes", "reason"}),
    }


def _controller(controller: ControllerStatus) -> dict[str, Any]:
    fields = {"controller", "priority", "actuators", "required", "state", "accepted", "late", "rejected", "missed"}
    return controller.model_dump(mode="json", include=fields) | {"response": _latency(controller.response)}


def _latency(summary: LatencySummary) -> dict[str, Any]:
    values = summary.model_dump()
    return {"count": values["count"], **{name: number(values[name]) for name in ("median_ms", "p99_ms", "max_ms")}}


def _alarm(alarm: AlarmStatus) -> dict[str, Any]:
    return alarm.model_dump(mode="json", exclude={"text"}) | {"text": alarm.text, "is_open": is_open(alarm)}


def is_open(alarm: AlarmStatus) -> bool:
    """Return whether an alarm awaits an acknowledgment."""
    return alarm.state in OPEN_STATES


def _sample(description: NodeDescription, sample: SampleView) -> dict[str, Any]:
    sources = sample.message.sources
    index = {source: number for number, source in enumerate(sources)}
    names = list(sample.value_source.values())
    return {
        "sample_step": sample.step,
        "values": numbers(sample.values) + numbers(sample.effective),
        "commanded": numbers(sample.commanded),
        "sources": list(sources),
        "source": [index[name] for name in names],
        "zones": zone_states(description, sample),
    }


def zone_states(description: NodeDescription, sample: SampleView) -> list[dict[str, Any]]:
    """Return for each zone its band in °C, its deviation from it in K with its color, and whether it is occupied."""
    comfort = description.comfort
    if comfort is None:
        return []
    begin = sample.time - timedelta(seconds=description.manifest.step_s)
    low, high = comfort.limits(sample.values, begin)
    deviations = comfort.deviations(sample.values, begin)
    occupied = comfort.is_occupied(sample.values)
    return [
        {
            "low": number(low[zone]),
            "high": number(high[zone]),
            "deviation": number(deviations[zone]),
            "color": hex_color(comfort_color(float(deviations[zone]))),
            "occupied": bool(occupied[zone]),
        }
        for zone in range(len(low))
    ]


def summary(
    description: NodeDescription, state: dict[str, Any] | None, rate: float | None, problem: str
) -> dict[str, Any]:
    """Return a node's entry in the list of nodes; `problem` says why it is not reachable.

    `rate` is the number of simulated seconds per second, as measured.
    """
    manifest = description.manifest
    entry: dict[str, Any] = {
        "node": manifest.node,
        "building": manifest.building,
        "weather": manifest.weather,
        "location": manifest.location,
        "branch_of": manifest.branch_of,
        "replay": manifest.replay,
        "steps": manifest.steps,
        "online": state is not None,
        "problem": problem,
    }
    if state is None:
        return entry
    names = ("state", "mode", "speed", "paused", "step", "time", "episode", "failure", "faults", "recording")
    entry |= {name: state[name] for name in names}
    entry["rate"] = number(rate)
    entry["controllers"] = [
        {"controller": controller["controller"], "state": controller["state"]} for controller in state["controllers"]
    ]
    entry["alarms"] = alarm_counts(state["alarms"])
    if "values" in state:
        zones, values = state["zones"], state["values"]
        entry["zones"] = len(zones)
        entry["comfortable"] = sum(zone["deviation"] == 0 for zone in zones)
        entry["uncomfortable_occupied"] = sum(bool(zone["deviation"]) and zone["occupied"] for zone in zones)
        outdoor, power = description.roles.outdoor_temperature, description.roles.facility_power
        entry["outdoor"] = None if outdoor is None else values[outdoor]
        entry["outdoor_label"] = description.content["outdoor_label"]
        entry["power_kw"] = None if power is None else scaled(values[power.index], power.to_kw)
        manual = [name for name in state["sources"] if name]
        entry["sources"] = sorted({manual[i - 1] for i in state["source"] if 0 < i <= len(manual)})
    return entry


def alarm_counts(alarms: Sequence[dict[str, Any]]) -> dict[str, int]:
    """Return the number of alarms by state, without those that are normal; `open` are those to acknowledge."""
    counts = Counter(alarm["state"] for alarm in alarms if alarm["state"] != AlarmState.NORMAL)
    return {**counts, "open": sum(alarm["is_open"] and alarm["notify"] == "alarm" for alarm in alarms)}


def scaled(value: float | None, factor: float) -> float | None:
    """Return a value in another unit; None stays None."""
    return None if value is None else number(value * factor)
