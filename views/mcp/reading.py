"""Tools that read: nodes, points, priorities, histories, alarms, events."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from zenostat.agent_sdk.semantic import PATTERNS
from zenostat.bridge.client.history import History
from zenostat.metrics.labels import words
from zenostat.topics.errors import NodeLost, NodeNotFound, RequestRejected, ZenostatError
from zenostat.topics.messages import AlarmState
from zenostat.topics.points import PointIndex
from zenostat.views.mcp.content import Content
from zenostat.views.mcp.desk import Desk
from zenostat.views.mcp.picture import draw_history
from zenostat.views.mcp.tool import End, Node, Point, Start, Tool
from zenostat.views.room.description import NodeDescription
from zenostat.views.room.numbers import number, numbers
from zenostat.views.room.priorities import priority_arrays
from zenostat.views.room.state import node_state, summary, zone_states

_MAX_NODES = 100
_MAX_DRAWN = 2000
_LEFT_OUT = ("faults", "recording", "rate", "problem")
"""Fields of a summary that a model does not get: an injected fault is what it is to diagnose."""


class ListNodes(Tool):
    """List the nodes of the bus: the buildings, or other plants, that are simulated.

    Each with its state, simulated time, outdoor temperature, power, zones within their comfort bands, controllers
    and alarms.
    """

    name: ClassVar[str] = "list_nodes"

    @override
    def run(self, desk: Desk) -> Content:
        names = _names(desk)
        if not names:
            desk.bus.check_link()
        entries = [entry for name in names[:_MAX_NODES] if (entry := _entry(desk, name)) is not None]
        return Content({"nodes": entries, "not_listed": max(0, len(names) - _MAX_NODES)})


def _names(desk: Desk) -> list[str]:
    """Return the names of all nodes but the branches of others."""
    names = desk.bus.nodes()
    known = {*names}
    return [name for name in names if name.rpartition(".")[0] not in known or not _is_branch(desk, name)]


def _is_branch(desk: Desk, node: str) -> bool:
    try:
        return bool(desk.bus.manifest(node).branch_of)
    except ZenostatError:  # if it is still there, its entry has the reason
        return False


def _entry(desk: Desk, node: str) -> dict[str, Any] | None:
    """Return a node's entry; None for a branch, or if it has left."""
    try:
        description = desk.description(node)
        if description.manifest.branch_of:
            return None
        alarms = None if description.manifest.replay else desk.bus.alarms(node)
        state = node_state(description, desk.bus.status(node), desk.sample(description.manifest), alarms)
    except (NodeLost, NodeNotFound):
        return None
    except ZenostatError as error:
        return {"node": node, "online": False, "problem": str(error)}
    entry = summary(description, state, None, "")
    return {name: value for name, value in entry.items() if name not in _LEFT_OUT}


class FindPoints(Tool):
    """Find points of a node: sensors, meters and actuators.

    A sensor is a measured value, a meter the consumption in a timestep, an actuator can be commanded. All words
    must be in the name, the label, the zone or the EnergyPlus variable. A pattern asks the semantic model instead,
    for example for the cooling setpoints of zones that an air handler with an economizer feeds.
    """

    name: ClassVar[str] = "find_points"

    node: Node
    words: Annotated[str, Field(max_length=200, description="Words to search for; empty finds all points.")] = ""
    kind: Annotated[Literal["sensor", "meter", "actuator"] | None, Field(description="Kind of point.")] = None
    pattern: Annotated[
        str | None, Field(max_length=64, description=f"Question to the semantic model: {', '.join(PATTERNS)}.")
    ] = None
    limit: Annotated[int, Field(ge=1, le=500, description="Largest number of points to return.")] = 60

    @override
    def run(self, desk: Desk) -> Content:
        description = desk.description(self.node)
        manifest = description.manifest
        points = description.content["points"]
        zones = [zone["key"] for zone in description.content["zones"]]
        places: dict[str, list[str]] = {}
        if self.pattern is not None:
            for each in desk.semantic_model(manifest).find(self.pattern):
                places.setdefault(each.name, []).append(each.place)
            points = [point for point in points if point["name"] in places]
        measured = {point.name: point for point in manifest.points}
        actuators = {point.name: point for point in manifest.actuators}
        chosen = []
        for point in points:
            is_actuator = point["kind"] == "actuator"
            source = actuators[point["name"]] if is_actuator else measured[point["name"]]
            zone = "" if point["zone"] is None else zones[point["zone"]]
            variable = getattr(source, "variable", "") or getattr(source, "meter", "")
            variable = variable or getattr(source, "control_type", "")
            text = " ".join([point["name"], point["label"], zone, variable, getattr(source, "key", "")])
            known = {*words(text), *text.casefold().split()}
            if not set(words(self.words)) <= known or self.kind not in (None, point["kind"]):
                continue
            entry = {name: point[name] for name in ("name", "label", "kind")}
            entry |= {"unit": source.unit, "zone": zone, "variable": variable}
            if is_actuator:
                entry |= {"low": number(source.low), "high": number(source.high)}
            chosen.append(entry | ({"places": places[point["name"]]} if places else {}))
        return Content({"node": self.node, "number": len(chosen), "points": chosen[: self.limit]})


class ReadPoints(Tool):
    """Read the present values of points.

    Of an actuator: the value in effect, the command, and who set it (empty: the building's own baseline control). A
    value of null is missing. Values of sensors are as published: a sensor may be wrong. An actuator that has the name
    of a sensor is actuator/{name}.
    """

    name: ClassVar[str] = "read_points"

    node: Node
    points: Annotated[list[Point], Field(min_length=1, max_length=64, description="Names of points.")]

    @override
    def run(self, desk: Desk) -> Content:
        description = desk.description(self.node)
        manifest = description.manifest
        sample = desk.sample(manifest)
        if sample is None:
            raise RequestRejected(f"node {self.node!r} has no sample yet")
        places = require_points(description, self.points)
        values, width = [*numbers(sample.values), *numbers(sample.effective)], len(manifest.points)
        commanded, sources = numbers(sample.commanded), sample.value_source
        units = [point.unit for point in (*manifest.points, *manifest.actuators)]
        entries = []
        for name, index in zip(self.points, places, strict=True):
            entry: dict[str, Any] = {"name": name, "value": values[index], "unit": units[index]}
            if index >= width:
                actuator = manifest.actuators[index - width]
                entry |= {"commanded": commanded[index - width], "source": sources[actuator.name]}
                permitted = None if desk.writer is None else desk.writer.describe(actuator)
                entry |= {} if permitted is None else {"may_be_written": permitted}
            entries.append(entry)
        return Content({"node": self.node, "time": sample.time.isoformat(), "points": entries})


class ReadZones(Tool):
    """Read the present state of all zones of a node.

    Temperature, the comfort band, how far the temperature is outside of it (K), people, and the setpoints in
    effect.
    """

    name: ClassVar[str] = "read_zones"

    node: Node

    @override
    def run(self, desk: Desk) -> Content:
        description = desk.description(self.node)
        sample = desk.sample(description.manifest)
        if sample is None:
            raise RequestRejected(f"node {self.node!r} has no sample yet")
        values = numbers(sample.values)
        states = zone_states(description, sample)
        entries = []
        for place, zone in enumerate(description.content["zones"]):
            entry = {"zone": zone["key"]}
            entry |= {
                name: None if zone[name] is None else values[zone[name]]
                for name in ("temperature", "humidity", "occupants", "heating_setpoint", "cooling_setpoint")
            }
            names = description.manifest.names
            entry["temperature_point"] = names[zone["temperature"]]
            if place < len(states):
                band = states[place]
                entry |= {"band": [band["low"], band["high"]], "deviation": band["deviation"]}
            entries.append(entry)
        return Content(
            {
                "node": self.node,
                "time": sample.time.isoformat(),
                "band_source": description.content["band"],
                "zones": entries,
            }
        )


class ReadPriorities(Tool):
    """Read the priority array of an actuator: 16 entries, that of priority 1 first.

    Each has its value, who set it and when it expires. The first entry with a value is in effect; without any,
    baseline control is.
    """

    name: ClassVar[str] = "read_priorities"

    node: Node
    actuator: Annotated[Point, Field(description="Name of the actuator.")]

    @override
    def run(self, desk: Desk) -> Content:
        manifest = desk.description(self.node).manifest
        return Content({"node": self.node, **priority_arrays(desk.bus, manifest, self.actuator)})


class ReadHistory(Tool):
    """Read the values of points in the present episode, as published, with minimum, mean and maximum.

    Of more samples than max_samples, only every k-th is returned, with the lowest and highest values between. Minimum,
    mean and maximum are those of all samples.
    """

    name: ClassVar[str] = "read_history"

    node: Node
    points: Annotated[list[Point], Field(min_length=1, max_length=16, description="Names of points.")]
    start: Start = None
    end: End = None
    max_samples: Annotated[int, Field(ge=2, le=500, description="Largest number of samples of each point.")] = 100

    @override
    def run(self, desk: Desk) -> Content:
        history = desk.bus.history(self.node, self.points, start=self.start, end=self.end)
        return Content({"node": self.node, **_history_data(history, _thinned(history, self.max_samples))})


class Plot(Tool):
    """Plot the history of points as a picture, with one panel for each unit."""

    name: ClassVar[str] = "plot"

    node: Node
    points: Annotated[list[Point], Field(min_length=1, max_length=12, description="Names of points.")]
    start: Start = None
    end: End = None

    @override
    def run(self, desk: Desk) -> Content:
        history = desk.bus.history(self.node, self.points, start=self.start, end=self.end)
        drawn = _thinned(history, _MAX_DRAWN)
        data = _history_data(history, drawn)
        for point in data["points"]:
            point.pop("values")
        data["time"] = [data["time"][0], data["time"][-1]]
        with desk.drawing:
            return Content({"node": self.node, **data}, draw_history(drawn))


class ReadAlarms(Tool):
    """Read the alarms of a node with their limits, states, and comments of operators.

    By default without those in their normal state.
    """

    name: ClassVar[str] = "read_alarms"

    node: Node
    with_normal: Annotated[bool, Field(description="Whether to include alarms in their normal state.")] = False

    @override
    def run(self, desk: Desk) -> Content:
        listed = desk.bus.alarms(self.node)
        alarms = [
            alarm.model_dump(mode="json", exclude_defaults=True) | {"state": alarm.state}
            for alarm in listed.alarms
            if self.with_normal or alarm.state != AlarmState.NORMAL
        ]
        return Content({"node": self.node, "time": listed.time, "rules": len(listed.alarms), "alarms": alarms})


class ReadEvents(Tool):
    """Read the latest events of a node since this server was started, the newest one last.

    Commands and writes that were not accepted, alarms, controllers that came and went, warnings, resets. Those of a
    node that has ended can be read until another one of its name starts.
    """

    name: ClassVar[str] = "read_events"

    node: Node
    count: Annotated[int, Field(ge=1, le=200, description="Largest number of events to return.")] = 50

    @override
    def run(self, desk: Desk) -> Content:
        events = [
            event.model_dump(mode="json", exclude={"alarm", "slot"}, exclude_defaults=True)
            for event in desk.events.latest(self.node, self.count)
        ]
        try:
            manifest = desk.description(self.node).manifest
        except (NodeLost, NodeNotFound):
            if not events:
                raise
            return Content({"node": self.node, "has_ended": True, "events": events})
        return Content({"node": self.node, "begin": manifest.begin, "step_s": manifest.step_s, "events": events})


def _thinned(history: History, max_samples: int) -> History:
    """Return at most so many samples of a history of all, the last one among them, with the extremes between."""
    stride = -(-len(history) // max_samples)
    ends = np.arange((len(history) - 1) % stride, len(history), stride)
    begins = np.concatenate(([0], ends[:-1] + 1))
    return replace(
        history,
        stride=stride,
        step=history.step[ends],
        values=history.values[ends],
        lows=np.fmin.reduceat(history.values, begins),
        highs=np.fmax.reduceat(history.values, begins),
    )


def _history_data(history: History, thinned: History) -> dict[str, Any]:
    """Return the samples of a thinned history, and minimum, mean and maximum of the whole one, as JSON values."""
    entries = []
    for column, (name, unit) in enumerate(zip(history.points, history.units, strict=True)):
        known = history.values[:, column]
        known = known[np.isfinite(known)]
        entry: dict[str, Any] = {"name": name, "unit": unit}
        entry |= {
            title: number(float(of(known))) if len(known) else None
            for title, of in (("min", np.min), ("mean", np.mean), ("max", np.max))
        }
        entry["values"] = numbers(thinned.values[:, column])
        if thinned.stride > 1 and thinned.lows is not None and thinned.highs is not None:
            entry |= {"lows": numbers(thinned.lows[:, column]), "highs": numbers(thinned.highs[:, column])}
        entries.append(entry)
    return {
        "episode": history.episode,
        "stride": thinned.stride,
        "time": [time.isoformat() for time in thinned.time.tolist()],
        "points": entries,
    }


def require_points(description: NodeDescription, points: list[str]) -> list[int]:
    """Return the indices of points among sensors, meters and actuators; `UnknownName` lists similar names."""
    manifest = description.manifest
    index = PointIndex((*manifest.names, *(each.name for each in manifest.actuators)), "point")
    index.require(points)
    return [index[name] for name in points]
