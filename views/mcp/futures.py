"""Tools that look ahead on branches: what-if, the baseline control, and reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from typing_extensions import override

from zenostat.bridge.client.sample import SampleView
from zenostat.metrics.episode_metrics import MetricsAccumulator
from zenostat.metrics.trajectory import Trajectory
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.errors import RequestRejected
from zenostat.topics.keys import safe_name
from zenostat.topics.messages import Sample
from zenostat.topics.points import value_index
from zenostat.views.mcp.content import Content
from zenostat.views.mcp.desk import Desk
from zenostat.views.mcp.reading import require_points
from zenostat.views.mcp.tool import Hours, Node, Point, Tool
from zenostat.views.report.files import write_report
from zenostat.views.report.runs import Comparison, Run
from zenostat.views.report.summary import summary
from zenostat.views.room.description import NodeDescription
from zenostat.views.room.numbers import number
from zenostat.views.room.what_if import Future, futures_content, simulate_futures

_MAX_SAMPLES = 100
_MAX_REPORT_VALUES = 20_000_000
_UNKNOWN_SOURCE = "not in the history"

Series = Annotated[
    list[Point], Field(max_length=12, description="Points whose values are returned for each future as well.")
]
FutureHours = Annotated[
    Hours | None,
    Field(description="Simulated hours to look ahead, at most 168; null: 24, or the most that can be simulated."),
]
Priority = Annotated[int, Field(ge=1, le=16, description="Priority of the values: 1 is the highest, 8 is manual.")]


class WhatIf(Tool):
    """Ask what would happen in the next hours with other values of some actuators.

    Copies of the building are simulated as it is and with the values, and compared: energy (kWh), peak power (kW)
    and degree-hours outside the comfort band. The building itself does not change. With no values, only the future
    as it is. Controllers do not run on copies: their last commands stay.
    """

    name: ClassVar[str] = "what_if"

    node: Node
    values: Annotated[
        dict[Point, float | None],
        Field(description="Values by actuator, in its unit; null relinquishes it at the priority."),
    ] = Field(default_factory=dict)
    hours: FutureHours = None
    priority: Priority = 8
    points: Series = Field(default_factory=list)

    @override
    def run(self, desk: Desk) -> Content:
        description = desk.description(self.node)
        futures = {"as_is": Future()}
        if self.values:
            futures["changed"] = Future(self.values, self.priority)
        return _compare(desk, description, futures, self.hours, self.points)


class CompareWithBaseline(Tool):
    """Compare the next hours of a building as it is with those under its own baseline control.

    All commands are relinquished for the baseline. Compares energy (kWh), peak power (kW) and degree-hours outside
    the comfort band. Simulated on copies; the building itself does not change.
    """

    name: ClassVar[str] = "compare_with_baseline"

    node: Node
    hours: FutureHours = None
    points: Series = Field(default_factory=list)

    @override
    def run(self, desk: Desk) -> Content:
        description = desk.description(self.node)
        futures = {"as_is": Future(), "baseline": Future(is_relinquished=True)}
        return _compare(desk, description, futures, self.hours, self.points)


class MakeReport(Tool):
    """Make a report of the present episode so far, as the node keeps it, or of the next hours.

    With `hours`, it compares the building as it is with its baseline control, simulated on copies. Returns the
    result in words; where this server has a folder for reports, also the path of an HTML file with figures.
    """

    name: ClassVar[str] = "make_report"

    node: Node
    hours: Annotated[Hours | None, Field(description="Simulated hours to look ahead; null: the episode so far.")] = None

    @override
    def run(self, desk: Desk) -> Content:
        description = desk.description(self.node)
        if self.hours is None:
            trajectories = {self.node: _so_far(desk, description)}
        else:
            futures = {"baseline": Future(is_relinquished=True), "present control": Future()}
            samples = _simulate(desk, description, futures, self.hours)
            trajectories = {name: _trajectory(description, each) for name, each in samples.items()}
        comparison = _comparison(trajectories)
        first = next(iter(trajectories.values()))
        data: dict[str, Any] = {
            "node": self.node,
            "from": first.begin.isoformat(),
            "to": first.end.isoformat(),
            "result": [text.replace("\N{NO-BREAK SPACE}", " ") for text in summary(comparison)],
        }
        if desk.reports is not None:
            end = first.end.strftime("%Y%m%dT%H%M%S")
            kind = "so-far" if self.hours is None else "ahead"
            path = desk.reports / f"{safe_name(self.node)}-{first.number}-{kind}-{end}.html"
            with desk.drawing:
                write_report(comparison, path)
            data["file"] = str(path)
        return Content(data)


def _simulate(
    desk: Desk, description: NodeDescription, futures: Mapping[str, Future], hours: float | None
) -> dict[str, list[Sample]]:
    """Simulate futures, one question at a time; errors as of `simulate_futures`."""
    if not desk.simulating.acquire(blocking=False):
        raise RequestRejected("another simulation on copies is running; ask again when it has ended")
    try:
        return simulate_futures(desk.bus, description, futures, hours, desk.source)
    finally:
        desk.simulating.release()


def _compare(
    desk: Desk, description: NodeDescription, futures: Mapping[str, Future], hours: float | None, points: list[str]
) -> Content:
    places = require_points(description, points)
    content = futures_content(description, _simulate(desk, description, futures, hours))
    times, (reference, *others) = content["time"], futures
    stride = max(1, -(-len(times) // _MAX_SAMPLES))
    data: dict[str, Any] = {
        "node": description.manifest.node,
        "from": content["begin"],
        "to": times[-1],
        "totals": {name: content[name]["totals"] for name in futures},
    }
    for name in others:
        data["difference"] = _difference(content[name]["totals"], content[reference]["totals"])
    if points:
        data |= {"stride": stride, "time": times[stride - 1 :: stride]}
        data["series"] = {
            point: {name: content[name]["series"][place][stride - 1 :: stride] for name in futures}
            for point, place in zip(points, places, strict=True)
        }
    return Content(data)


def _difference(totals: Mapping[str, float | None], reference: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return how much more a future has than the one as it is."""
    return {
        name: None if value is None or (other := reference[name]) is None else number(value - other)
        for name, value in totals.items()
        if name != "hours"
    }


def _trajectory(description: NodeDescription, samples: list[Sample]) -> Trajectory:
    manifest = description.manifest.model_copy(update={"slots": 1, "baseline": False})  # as of a branch
    recorder, index = TrajectoryRecorder(manifest), value_index(manifest)
    for sample in samples:
        recorder.add(SampleView(sample, manifest, index))
    return recorder.trajectory()


def _so_far(desk: Desk, description: NodeDescription) -> Trajectory:
    """Return the present episode as far as the node keeps it; who set the actuators is not in a history."""
    manifest = description.manifest
    width, actuators = len(manifest.points), len(manifest.actuators)
    if (width + actuators) * min(manifest.history_samples, manifest.steps + 1) > _MAX_REPORT_VALUES:
        raise RequestRejected("the history of this node is too large for a report; make one from its recording")
    history = desk.bus.history(manifest.node)
    if len(history) < 2:
        raise RequestRejected("no timestep has been simulated yet")
    return Trajectory(
        manifest, history.step, history.values[:, :width], history.values[:, width:],
        np.ones((len(history), actuators), np.uint16), ("", _UNKNOWN_SOURCE), number=history.episode,
    )  # fmt: skip


def _comparison(trajectories: Mapping[str, Trajectory]) -> Comparison:
    runs, sources = [], {}
    for name, trajectory in trajectories.items():
        manifest = trajectory.manifest.model_copy(update={"steps": trajectory.steps})  # the report is of these
        metrics = MetricsAccumulator(manifest, None)
        sources = metrics.sources
        runs.append(Run(name, (metrics.measure(trajectory),), replace(trajectory, manifest=manifest)))
    return Comparison(tuple(runs), sources=sources)
