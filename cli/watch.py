"""`zenostat watch`: a running node's points as they change."""

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

from bridge.transport.session import default_endpoint
from cli.console import err, out
from cli.options import CertificateName, Connect, Keys
from cli.read import Row, check_points, shown, where
from cli.read import rows as rows_of
from cli.tables import fitted
from topics.errors import NodeLost
from topics.keys import Role

if TYPE_CHECKING:
    from agent_sdk import Bus
    from agent_sdk.bus.sample import SampleView

_A_SECOND = 10
"""How often the table is drawn."""


def watch(
    node: Annotated[str, typer.Argument(help="The node's name.")],
    points: Annotated[list[str] | None, typer.Argument(help="Names of points; all if left out.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="End after so many samples.")] = None,
    slot: Annotated[int, typer.Option(min=0, help="Which engine of a node that has several.")] = 0,
    connect: Connect = None,
    keys: Keys = None,
    certificate: CertificateName = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print a line of JSON a sample.")] = False,
) -> None:
    """Shows a node's points as they change, from the present sample on, until Ctrl-C or the node's end.

    With keys, as a monitor.

    Example: `zenostat watch office core_zn_air_temperature core_zn_cooling_setpoint`
    """
    from agent_sdk import connect as connect_bus

    connect = connect or default_endpoint(keys)
    names = points or []
    table = _Extremes()
    try:
        with connect_bus(connect, keys=keys, role=Role.MONITOR, certificate=certificate) as bus:
            check_points(bus.manifest(node), names)
            drawn = Live(console=out, get_renderable=table.drawn, refresh_per_second=_A_SECOND)
            with nullcontext() if as_json else drawn:
                for sample in islice(_samples(bus, node, slot), steps):
                    if as_json:
                        _say(sample, names)
                    else:
                        table.take(sample, names)
    except NodeLost as lost:
        err.print(str(lost), markup=False)
    except KeyboardInterrupt:  # the way to end it
        return


def _samples(bus: Bus, node: str, slot: int) -> Iterator[SampleView]:
    """The present sample, and all that come; each once."""
    with bus.listen(node) as coming:
        latest = bus.read(node, slot=slot)
        yield latest
        for sample in coming:
            sample.slot = slot
            if (sample.episode, sample.step) > (latest.episode, latest.step):
                latest = sample
                yield sample


def _say(sample: SampleView, names: Sequence[str]) -> None:
    """One line of JSON."""
    found = rows_of(sample, names)
    line = {
        **where(sample),
        "points": {row.name: row.value for row in found if row.value_source is None},
        "actuators": {row.name: row.value for row in found if row.value_source is not None},
    }
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


class _Extremes:
    """The latest values, and the smallest and largest since it began."""

    def __init__(self) -> None:
        self._title = ""
        self._lines: list[tuple[Row, float | None, float | None]] = []

    def take(self, sample: SampleView, names: Sequence[str]) -> None:
        found = rows_of(sample, names)
        before = [(low, high) for _, low, high in self._lines] or [(None, None)] * len(found)
        self._title = f"{sample.manifest.node} at {sample.time}: sample {sample.step} of episode {sample.episode}"
        self._lines = [(row, *_widened(row.value, low, high)) for row, (low, high) in zip(found, before, strict=True)]

    def drawn(self) -> RenderableType:
        """As it is now; the thread that draws asks ten times a second."""
        rows = []
        for row, low, high in self._lines:
            source_index = "" if row.value_source is None else row.value_source or "the building"
            rows.append((row.name, row.kind, row.unit, shown(row.value), shown(low), shown(high), source_index))
        numbers = ("value", "min", "max")
        columns = ("name", "kind", "unit", *numbers, "ruled by")
        return fitted(columns, rows, out.width, title=self._title, right=numbers, wrap=("name", "ruled by"))


def _widened(value: float | None, low: float | None, high: float | None) -> tuple[float | None, float | None]:
    if value is None:
        return low, high
    return (value if low is None else min(low, value)), (value if high is None else max(high, value))
