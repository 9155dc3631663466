"""State timelines: each zone against its comfort band, and who sets each actuator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from bridge.display.colors import RGB, UNKNOWN, comfort_color, zone_color
from bridge.rerun.recording import EpisodeLog
from bridge.rerun.samples import Floats, SampleBlock

ZONES = "zones"
SOURCES = "sources"
BASELINE = "baseline control"

_LIMITS_K = (0.05, 1.0, 2.0, 4.0)
"""Deviations at which a zone's state changes."""

_BELOW = ("under 1 K below", "1 to 2 K below", "2 to 4 K below", "over 4 K below")
_ABOVE = ("under 1 K above", "1 to 2 K above", "2 to 4 K above", "over 4 K above")
_COLORS_K = (0.5, 1.5, 3.0, 4.0)
_WITHIN = "within"
_UNKNOWN_STATE = "unknown"
_UNOCCUPIED = ", unoccupied"
_NO_LABEL = "\u00a0"  # an empty label would show the state
WITHIN_COLOR: RGB = (116, 124, 118)  # darker than in other pictures: lit rows would outshine the deviations
_DARK: RGB = (24, 26, 28)
_BASELINE_COLOR: RGB = (84, 88, 92)


def comfort_states(deviations: Floats, is_occupied: NDArray[np.bool_]) -> NDArray[np.str_]:
    """Return the state of zones as text: `within`, `1 to 2 K above, unoccupied`, `unknown`.

    Args:
        deviations: from the comfort band in K, NaN if unknown, of any shape.
        is_occupied: of the same shape.
    """
    names = np.array([*reversed(_BELOW), _WITHIN, *_ABOVE, _UNKNOWN_STATE])
    edges = [*(-limit for limit in reversed(_LIMITS_K)), *_LIMITS_K]
    # A value at an edge has the state that is nearer to the band.
    level = np.where(
        deviations < 0,
        np.searchsorted(edges, deviations, side="right"),
        np.searchsorted(edges, deviations, side="left"),
    )
    level = np.where(np.isnan(deviations), len(names) - 1, level)
    states = np.char.add(names[level], np.where(is_occupied, "", _UNOCCUPIED))
    return np.where(np.isnan(deviations), _UNKNOWN_STATE, states)


def comfort_styles() -> dict[str, tuple[str, RGB]]:
    """Return the label and the color of each state; those of unoccupied zones are dark."""
    styles = {_WITHIN: (_NO_LABEL, WITHIN_COLOR), _UNKNOWN_STATE: ("unknown", UNKNOWN)}
    for sign, names in ((-1, _BELOW), (1, _ABOVE)):
        for name, deviation in zip(names, _COLORS_K, strict=True):
            styles[name] = (
                name.rpartition(" ")[0].replace("under ", "<").replace("over ", ">"),
                comfort_color(sign * deviation),
            )
    for name in (_WITHIN, *_BELOW, *_ABOVE):
        text, color = styles[name]
        styles[name + _UNOCCUPIED] = (text, _mixed(color, 0.58))
    return styles


def _mixed(color: RGB, share: float) -> RGB:
    red, green, blue = (round(channel + share * (dark - channel)) for channel, dark in zip(color, _DARK, strict=True))
    return red, green, blue


class StateTimelines:
    """Logs rows of states: only the changes.

    Args:
        log: where to log.
        path: entity above the rows.
        names: of the rows.
        styles: label and color of each state; more may be added with `add_style`.
    """

    def __init__(self, log: EpisodeLog, path: str, names: Sequence[str], styles: dict[str, tuple[str, RGB]]) -> None:
        self._log, self._styles = log, dict(styles)
        self._paths = [f"{path}/{name.replace('/', '-')}" for name in names]
        self._last = np.full(len(names), None, object)
        if styles:
            self._configure()

    def _configure(self) -> None:
        configuration = rr.StateConfiguration(
            values=list(self._styles),
            labels=[text for text, _ in self._styles.values()],
            colors=[list(color) for _, color in self._styles.values()],
        )
        for path in self._paths:
            self._log.static(path, configuration)

    def add_style(self, state: str, style: tuple[str, RGB]) -> None:
        """Set the label and the color of a state."""
        self._styles[state] = style
        self._configure()

    def has_style(self, state: str) -> bool:
        """Return whether a state has a style."""
        return state in self._styles

    def add(self, block: SampleBlock, states: NDArray[np.object_]) -> None:
        """Log the changes of states, shape (n, rows)."""
        if not len(states):
            return
        before = np.concatenate([self._last[None, :], states[:-1]])
        changed = states != before
        self._last = states[-1]
        for column, path in enumerate(self._paths):
            rows = np.flatnonzero(changed[:, column])
            if len(rows):
                self._log.columns(path, block, rr.StateChange.columns(state=states[rows, column].tolist()), rows)


class ZoneTimelines:
    """Logs each zone's state against its comfort band, and whether it is occupied."""

    def __init__(self, log: EpisodeLog, zones: Sequence[str]) -> None:
        self._rows = StateTimelines(log, ZONES, zones, comfort_styles())

    def add(self, block: SampleBlock) -> None:
        """Log the changes of states."""
        self._rows.add(block, comfort_states(block.deviations, block.is_occupied).astype(object))


class SourceTimelines:
    """Logs who sets each actuator."""

    def __init__(self, log: EpisodeLog, actuators: Sequence[str]) -> None:
        self._rows = StateTimelines(log, SOURCES, actuators, {BASELINE: (BASELINE, _BASELINE_COLOR)})
        self._known = 0

    def add(self, block: SampleBlock) -> None:
        """Log the changes of value sources."""
        states = np.where(block.sources == "", BASELINE, block.sources)
        for name in dict.fromkeys(states.ravel().tolist()):
            if not self._rows.has_style(name):
                self._rows.add_style(name, (name, zone_color(self._known)))
                self._known += 1
        self._rows.add(block, states)
