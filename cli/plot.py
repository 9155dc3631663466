"""`zenostat plot`: the history of a node's points as charts in the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.cli.console import out
from zenostat.cli.options import DEFAULTS, BusOptions, Node, Slot, on_bus
from zenostat.cli.read import check_points
from zenostat.cli.tables import show_json
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import Role
from zenostat.topics.units import unit_label, with_unit

if TYPE_CHECKING:
    from zenostat.bridge.client.history import History
    from zenostat.cli.chart import Line

_SAMPLES_PER_COLUMN = 8
"""More samples per character would not be visible."""


@on_bus
def plot(
    node: Node,
    points: Annotated[list[str], typer.Argument(help="Names of sensors, meters and actuators.")],
    start: Annotated[
        str | None, typer.Option("--from", metavar="TIME", help="Simulated time: 07-03, or 07-03T06:00.")
    ] = None,
    end: Annotated[str | None, typer.Option("--to", metavar="TIME", help="Simulated time of the last sample.")] = None,
    slot: Slot = 0,
    height: Annotated[int, typer.Option(min=3, max=200, help="Lines of each chart.")] = 10,
    options: BusOptions = DEFAULTS,
    as_json: Annotated[bool, typer.Option("--json", help="Print all samples as JSON.")] = False,
) -> None:
    """Plot points over the present episode, as far back as the node keeps samples.

    Points of one unit share a chart if the terminal has colors, and otherwise a scale. With keys, it uses the monitor
    role.

    Example: `zenostat plot office core_zn_air_temperature core_zn_cooling_setpoint`
    """
    names = list(dict.fromkeys(points))
    limit = None if as_json else _SAMPLES_PER_COLUMN * out.width
    with options.open_bus(Role.MONITOR) as bus:
        check_points(bus.manifest(node), names)
        try:
            history = bus.history(node, names, slot=slot, start=start, end=end, max_samples=limit, extremes=not as_json)
        except InvalidConfig as error:
            text = str(error)
            for word, option in (("start ", "--from "), ("end ", "--to ")):
                text = option + text.removeprefix(word) if text.startswith(word) else text
            raise InvalidConfig(text) from None
    if as_json:
        _print_json(history)
    else:
        _print_charts(history, height)


def _print_json(history: History) -> None:
    columns = zip(history.points, history.units, history.values.T.tolist(), strict=True)
    show_json(
        {
            "node": history.manifest.node,
            "episode": history.episode,
            "slot": history.slot,
            "oldest_step": history.oldest_step,
            "step": history.step.tolist(),
            "time": [time.isoformat() for time in history.time.tolist()],
            "points": {name: {"unit": unit, "values": values} for name, unit, values in columns},
        }
    )


def _print_charts(history: History, height: int) -> None:
    from rich.text import Text

    from zenostat.cli.chart import COLORS, chart, label_width, scale_of

    times, is_colored = history.time.tolist(), out.is_terminal and not out.no_color and out.color_system is not None
    out.print(_title(history, times))
    of_unit = {
        unit: [name for name, own in zip(history.points, history.units, strict=True) if own == unit]
        for unit in dict.fromkeys(history.units)
    }
    scales = {unit: scale_of([_line(history, name, "") for name in names], height) for unit, names in of_unit.items()}
    margin, is_unicode = max(map(label_width, scales.values())), not out.options.ascii_only
    for unit, names in of_unit.items():
        lines = [_line(history, name, COLORS[i % len(COLORS)] if is_colored else "") for i, name in enumerate(names)]
        for panel in [range(len(names))] if is_colored else [range(i, i + 1) for i in range(len(names))]:
            drawn = [lines[i] for i in panel]
            out.print()
            for i in panel:
                out.print(Text(_legend(names[i], unit, lines[i]), style=lines[i].color))
            for text in chart(
                drawn, times, width=out.width, rows=height, scale=scales[unit], margin=margin, is_unicode=is_unicode
            ):
                out.print(text)


def _line(history: History, name: str, color: str) -> Line:
    from zenostat.cli.chart import Line

    column = history.points.index(name)
    assert history.lows is not None
    assert history.highs is not None
    return Line(history.values[:, column], history.lows[:, column], history.highs[:, column], color)


def _title(history: History, times: Sequence[datetime]) -> str:
    slot = f", slot {history.slot}" if history.manifest.slots > 1 else ""
    span = f"{times[0]:%Y-%m-%d %H:%M} to {times[-1]:%Y-%m-%d %H:%M}"
    sampling = f", with the range of every {history.stride} samples" if history.stride > 1 else ""
    older = f", of which the node keeps steps from {history.oldest_step}" if history.oldest_step else ""
    return f"{history.manifest.node}, episode {history.episode}{slot}{older}: {span}{sampling}"


def _legend(name: str, unit: str, line: Line) -> str:
    import numpy as np

    finite = line.values[np.isfinite(line.values)]
    if not finite.size:
        return f"{name}: no values"
    low, high = np.nanmin(line.lows), np.nanmax(line.highs)
    latest = f"{finite[-1]:.5g}" if math.isfinite(line.values[-1]) else "missing"
    label = unit_label(unit)
    return f"{name}: {with_unit(f'{low:.5g} to {high:.5g}', label)}, latest {latest}"
