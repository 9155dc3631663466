"""Tools that write: only where the server was started with `--allow-writes`."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field
from typing_extensions import override

from zenostat.topics.errors import AccessDenied
from zenostat.views.mcp.content import Content
from zenostat.views.mcp.desk import Desk
from zenostat.views.mcp.tool import Node, Point, Tool
from zenostat.views.mcp.writer import Writer

Name = Annotated[Point, Field(description="Name of the actuator.")]


class Write(Tool):
    """Command an actuator of a building for a time, after which the value is relinquished.

    The priority is low: values of people and of controllers at higher priorities stay in effect, as the result
    tells. Only some actuators may be written, within a range: read_points shows it as may_be_written. Ask what_if
    before.
    """

    name: ClassVar[str] = "write"
    writes: ClassVar[bool] = True

    node: Node
    actuator: Name
    value: Annotated[float, Field(description="Value in the actuator's unit.")]
    minutes: Annotated[float, Field(gt=0, description="Simulated minutes until the value is relinquished.")]
    reason: Annotated[str, Field(min_length=3, max_length=300, description="Why, in a sentence, for the audit log.")]

    @override
    def run(self, desk: Desk) -> Content:
        writer, manifest = _writer(desk), desk.description(self.node).manifest
        effect = writer.write(manifest, self.actuator, self.value, self.minutes * 60)
        return Content({"node": self.node, "actuator": self.actuator, **effect})


class Relinquish(Tool):
    """Relinquish a value that this server has written: the next lower priority takes effect, or baseline control."""

    name: ClassVar[str] = "relinquish"
    writes: ClassVar[bool] = True

    node: Node
    actuator: Name
    reason: Annotated[str, Field(min_length=3, max_length=300, description="Why, in a sentence, for the audit log.")]

    @override
    def run(self, desk: Desk) -> Content:
        writer, manifest = _writer(desk), desk.description(self.node).manifest
        effect = writer.relinquish(manifest, self.actuator)
        return Content({"node": self.node, "actuator": self.actuator, **effect})


def _writer(desk: Desk) -> Writer:
    if desk.writer is None:
        raise AccessDenied("this server only reads; it writes if it is started with --allow-writes")
    return desk.writer
