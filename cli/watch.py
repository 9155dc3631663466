"""`zenostat watch`: a live table of a node's points."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from itertools import islice
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType
from rich.live import Live

from zenostat.cli.console import err, out
from zenostat.cli.options import DEFAULTS, BusOptions, Node, Slot, on_bus
from zenostat.cli.read import Row, check_points, format_source, format_value, sample_id
from zenostat.cli.read import rows as rows_of
from zenostat.cli.tables import fitted
from zenostat.topics.errors import NodeLost
from zenostat.topics.json_numbers import finite
from zenostat.topics.keys import Role
from zenostat.topics.units import unit_label

if TYPE_CHECKING:
    from zenostat import Bus
    from zenostat.bridge.client.sample import SampleView

_REFRESHES_PER_SECOND = 10


@on_bus
def watch(
    node: Node,
    points: Annotated[list[str] | None, typer.Argument(help="Names of points. Default: all.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Stop after this many samples.")] = None,
    slot: Slot = 0,
    options: BusOptions = DEFAULTS,
    as_json: Annotated[bool, typer.Option("--json", help="Print one line of JSON per sample.")] = False,
) -> None:
    """Show a node's points as they change, with their extremes, until Ctrl-C, or until the node or its link ends.

    With keys, it uses the monitor role.

    Example: `zenostat watch office core_zn_air_temperature core_zn_cooling_setpoint`
    """
    names = points or []
    table = _Extremes()
    try:
        with options.open_bus(Role.MONITOR) as bus:
            check_points(bus.manifest(node), names)
            live = Live(console=out, get_renderable=table.render, refresh_per_second=_REFRESHES_PER_SECOND)
            with nullcontext() if as_json else live:
                for sample in islice(_samples(bus, node, slot), steps):
                    if as_json:
                        _print_json(sample, names)
                    else:
                        table.update(sample, names)
    except NodeLost as error:
        err.print(str(error))
    except KeyboardInterrupt:  # the usual way to stop
        return


def _samples(bus: Bus, node: str, slot: int) -> Iterator[SampleView]:
    """Yield the latest sample and all that follow, each once."""
    with bus.listen(node) as stream:
        latest = bus.read(node, slot=slot)
        yield latest
        for sample in stream:
            sample.slot = slot
            if (sample.episode, sample.step) > (latest.episode, latest.step):
                latest = sample
                yield sample


def _print_json(sample: SampleView, names: Sequence[str]) -> None:
    listed = rows_of(sample, names)
    line = {
        **sample_id(sample),
        "points": {row.name: row.value for row in listed if row.value_source is None},
        "actuators": {row.name: row.value for row in listed if row.value_source is not None},
    }
    sys.stdout.write(json.dumps(finite(line)) + "\n")
    sys.stdout.flush()


class _Extremes:
    """Table of the latest values, and the smallest and largest since the command started."""

    def __init__(self) -> None:
        self._title = ""
        self._lines: list[tuple[Row, float | None, float | None]] = []

    def update(self, sample: SampleView, names: Sequence[str]) -> None:
        """Replace the values by those of a sample, and widen the extremes."""
        listed = rows_of(sample, names)
        extremes = [(low, high) for _, low, high in self._lines] or [(None, None)] * len(listed)
        self._title = f"{sample.manifest.node} at {sample.time}: sample {sample.step} of episode {sample.episode}"
        self._lines = [(row, *_widen(row.value, low, high)) for row, (low, high) in zip(listed, extremes, strict=True)]

    def render(self) -> RenderableType:
        """Return the table; the thread of `rich.live.Live` calls this."""
        rows = []
        for row, low, high in self._lines:
            numbers = (format_value(row.value), format_value(low), format_value(high))
            rows.append((row.name, row.kind, unit_label(row.unit), *numbers, format_source(row)))
        columns = ("name", "kind", "unit", "value", "min", "max", "value source")
        return fitted(columns, rows, out.width, title=self._title, right=columns[3:6], wrap=("name", "value source"))


def _widen(value: float | None, low: float | None, high: float | None) -> tuple[float | None, float | None]:
    if value is None:
        return low, high
    return (value if low is None else min(low, value)), (value if high is None else max(high, value))
