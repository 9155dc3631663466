"""Data for dashboards of others: metrics as Prometheus reads them, histories as Grafana's JSON data source does."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Iterator, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from zenostat.topics.errors import InvalidConfig, UsageError, ZenostatError
from zenostat.topics.messages import AlarmState
from zenostat.views.room.bus_watch import BusWatch
from zenostat.views.room.node_watch import NodeWatch
from zenostat.views.room.numbers import numbers
from zenostat.views.room.series import MAX_POINTS, MAX_SAMPLES, HistoryCache, simulated_time, times_ms

METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_HELP = {
    "zenostat_node_up": ("gauge", "Whether the node is reachable."),
    "zenostat_node_paused": ("gauge", "Whether the node is paused."),
    "zenostat_node_step": ("gauge", "Step of the present episode."),
    "zenostat_node_episode": ("gauge", "Number of the present episode."),
    "zenostat_node_speed_ratio": ("gauge", "Simulated seconds per second, as measured."),
    "zenostat_node_power_kilowatts": ("gauge", "Electric power of the building."),
    "zenostat_node_zones": ("gauge", "Zones with a temperature."),
    "zenostat_node_zones_comfortable": ("gauge", "Zones within their comfort bands."),
    "zenostat_node_alarms": ("gauge", "Alarms that are not normal, by state."),
    "zenostat_node_faults": ("gauge", "Injected faults that are active."),
    "zenostat_node_overruns_total": ("counter", "Paced timesteps that were late."),
    "zenostat_node_commands_total": ("counter", "Commands of controllers by outcome; of writes, those not accepted."),
    "zenostat_node_step_milliseconds": ("gauge", "Duration of a timestep, by statistic."),
    "zenostat_node_memory_bytes": ("gauge", "Memory of the node and its engines."),
    "zenostat_controller_connected": ("gauge", "Whether a controller with a claim is connected."),
    "zenostat_controller_late_total": ("counter", "Commands that were too late."),
    "zenostat_controller_response_milliseconds": ("gauge", "Response time of a controller, by statistic."),
    "zenostat_room_followers": ("gauge", "Open pages of the control room."),
}


def prometheus(watch: BusWatch) -> str:
    """Return the metrics of all nodes in Prometheus's text format."""
    samples: dict[str, list[str]] = {name: [] for name in _HELP}
    for node in watch.watches():
        if node.state is None and node.is_branch:
            continue
        for name, labels, value in _node_metrics(node):
            if value is not None:
                samples[name].append(f"{name}{_labels(node=node.node, **labels)} {float(value):.15g}")
    samples["zenostat_room_followers"].append(f"zenostat_room_followers {watch.updates.followers}")
    lines = []
    for name, (kind, text) in _HELP.items():
        if samples[name]:
            lines += [f"# HELP {name} {text}", f"# TYPE {name} {kind}", *samples[name]]
    return "\n".join(lines) + "\n"


_Metric = tuple[str, dict[str, str], float | None]


def _node_metrics(node: NodeWatch) -> Iterator[_Metric]:
    if node.has_ended:
        return
    entry, state = node.summary, node.state
    yield "zenostat_node_up", {}, state is not None
    if entry is None or state is None or not entry["online"]:
        return
    prefix = "zenostat_node_"
    simple = {
        "paused": entry["paused"],
        "step": entry["step"],
        "episode": entry["episode"],
        "speed_ratio": entry["rate"],
        "power_kilowatts": entry.get("power_kw"),
        "zones": entry.get("zones"),
        "zones_comfortable": entry.get("comfortable"),
        "faults": len(entry["faults"]),
        "overruns_total": state["overruns"],
        "memory_bytes": state["memory_bytes"],
    }
    yield from ((prefix + name, {}, value) for name, value in simple.items())
    states = (name for name in AlarmState if name != AlarmState.NORMAL)
    yield from ((f"{prefix}alarms", {"state": str(name)}, entry["alarms"].get(name, 0)) for name in states)
    yield from ((f"{prefix}commands_total", {"outcome": name}, count) for name, count in state["counts"].items())
    for statistic in ("median", "p99", "max"):
        yield f"{prefix}step_milliseconds", {"statistic": statistic}, state["step_time"][f"{statistic}_ms"]
    for controller in state["controllers"]:
        labels = {"controller": controller["controller"]}
        is_connected = controller["state"] in ("connected", "unresponsive")
        yield "zenostat_controller_connected", labels, is_connected
        yield "zenostat_controller_late_total", labels, controller["late"]
        for statistic in ("median", "p99", "max"):
            value = controller["response"][f"{statistic}_ms"]
            yield "zenostat_controller_response_milliseconds", labels | {"statistic": statistic}, value


def _labels(**labels: str) -> str:
    """Return labels in Prometheus's form: backslashes, quotes and line breaks of a value are escaped."""
    texts = []
    for name, value in labels.items():
        escaped = value.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
        texts.append(f'{name}="{escaped}"')
    return "{" + ",".join(texts) + "}"


GrafanaSeries = dict[str, dict[str, Any]]
"""Series as Grafana's JSON data source has them, by target."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", populate_by_name=True)


class _Range(_Part):
    begin: Annotated[str, Field(alias="from")]
    end: Annotated[str, Field(alias="to")]


class _Target(_Part):
    target: str | None = None  # of a query that is being edited


class GrafanaQuery(_Part):
    """A query of Grafana's JSON data source: some targets `NODE/POINT` in a range of time."""

    range: _Range | None = None
    targets: Annotated[list[_Target], Field(max_length=64)] = Field(default_factory=list)
    max_data_points: Annotated[float | None, Field(alias="maxDataPoints")] = None

    @property
    def max_samples(self) -> int:
        """Largest number of samples of a series, within the limits of histories."""
        return 1000 if self.max_data_points is None else int(min(max(2, self.max_data_points), MAX_SAMPLES))

    def names(self) -> list[str]:
        """Return the names `NODE/POINT`, each once; others are left out.

        Raises:
            InvalidConfig: there are only others, or too many.
        """
        every = dict.fromkeys(name for target in self.targets for name in target_names(target.target or ""))
        if len(every) > MAX_POINTS:
            raise InvalidConfig(f"targets: at most {MAX_POINTS} points expected, not {len(every)}")
        names = [name for name in every if name.partition("/")[2]]
        if every and not names:
            raise InvalidConfig(
                f"target {next(iter(every))!r}: NODE/POINT expected, such as office/electricity_facility"
            )
        return names


class GrafanaVariable(_Part):
    """A query of a dashboard's variable: `nodes`, or the `points` of one, of some unit and kind."""

    target: str = "nodes"
    node: str | list[str] = ""
    unit: str = ""
    kind: str = ""


class GrafanaVariableQuery(_Part):
    """Request of Grafana's JSON data source for the values of a variable."""

    payload: GrafanaVariable = Field(default_factory=GrafanaVariable)


def grafana_variable(watch: BusWatch, query: GrafanaVariableQuery) -> list[dict[str, str]]:
    """Return the values of a dashboard's variable: names of nodes, or of points as in `grafana_targets`.

    Units are those of the bus, such as `degC`; kinds are `sensor`, `meter` and `actuator`.

    Raises:
        InvalidConfig: it is neither of nodes nor of points.
    """
    asked = query.payload
    if asked.target not in ("nodes", "points"):
        raise InvalidConfig(f"target {asked.target!r}: nodes or points expected")
    wanted = [asked.node] if isinstance(asked.node, str) else asked.node
    values = []
    for node in watch.watches():
        if node.state is None or node.description is None:
            continue
        if asked.target == "nodes":
            values.append((node.node, node.node))
        elif node.node in wanted or wanted == [""]:
            points, listed = node.description.manifest, node.description.content["points"]
            units = [point.unit for point in (*points.points, *points.actuators)]
            values += [
                (point["label"], f"{node.node}/{point['id']}")
                for point, unit in zip(listed, units, strict=True)
                if asked.unit in ("", unit) and asked.kind in ("", point["kind"])
            ]
    return [{"__text": text, "__value": value} for text, value in values]


def target_names(target: str) -> list[str]:
    """Return the points that a target names: `NODE/POINT`, or what Grafana makes of a variable.

    Grafana writes a variable's value as a regular expression: characters are escaped, and several values are
    alternatives in parentheses.
    """
    text = target[1:-1] if target.startswith("(") and target.endswith(")") else target
    return [re.sub(r"\\(.)", r"\1", name) for name in text.split("|") if name]


def grafana_targets(watch: BusWatch) -> list[dict[str, str]]:
    """Return all points of all nodes as targets."""
    targets = []
    for node in watch.watches():
        if node.state is not None and node.description is not None:
            names = [f"{node.node}/{point['id']}" for point in node.description.content["points"]]
            targets += [{"label": name, "value": name} for name in names]
    return targets


async def grafana_answer(
    query: GrafanaQuery, read: Callable[[str, list[str]], Awaitable[GrafanaSeries]]
) -> list[dict[str, Any]]:
    """Return the series of a query's targets, without those that cannot be read if others can.

    Args:
        query: the query.
        read: returns the series of points of a node; see `grafana_series`.

    Raises:
        ZenostatError: none of the targets can be read.
    """
    names, points = query.names(), dict[str, list[str]]()
    for name in names:
        node, _, point = name.partition("/")
        points.setdefault(node, []).append(point)
    errors: list[ZenostatError] = []

    async def series_of(node: str) -> GrafanaSeries:
        try:
            return await read(node, points[node])
        except ZenostatError as error:
            errors.append(error)
            return {}

    series = {name: each for part in await asyncio.gather(*map(series_of, points)) for name, each in part.items()}
    if errors and len(errors) == len(points):
        raise errors[0]
    return [series[name] for name in names if name in series]


def grafana_series(watch: NodeWatch, cache: HistoryCache, points: Sequence[str], query: GrafanaQuery) -> GrafanaSeries:
    """Return the values of a node's points by `NODE/POINT`, with their simulated times in ms, which stand for UTC.

    Points without samples in the range are left out, and so are those that do not exist if others do.

    Raises:
        ZenostatError: none of the points can be read, or the node keeps no history.
    """
    result: GrafanaSeries = {}
    errors: list[ZenostatError] = []
    for point in points:
        try:
            history = _history(watch, cache, point, query)
        except UsageError as error:
            errors.append(error)
            continue
        if history is not None:
            times, values = history
            target = f"{watch.node}/{point}"
            result[target] = {"target": target, "datapoints": [[v, t] for v, t in zip(values, times, strict=True)]}
    if len(errors) == len(points):
        raise errors[0]
    return result


def _history(
    watch: NodeWatch, cache: HistoryCache, point: str, query: GrafanaQuery
) -> tuple[list[int], list[float | None]] | None:
    """Return times and values; None if the range has no samples."""
    span = query.range
    start, end = (None, None) if span is None else (simulated_time(span.begin), simulated_time(span.end))
    try:
        history = cache.history(watch, [point], start, end, query.max_samples)
    except ZenostatError as error:
        if "no samples in that range" in str(error) or "before the episode" in str(error):
            return None
        raise
    return times_ms(history), numbers(history.values[:, 0])
