"""Priority arrays as clients of a real node see them, against what was sent."""

import json

import pytest
from support.run_cli import error_of, run_in_process

from zenostat import Bus
from zenostat.topics.errors import UnknownName

COOLING, HEATING = "core_zn_cooling_setpoint", "core_zn_heating_setpoint"


def _entries(bus: Bus) -> dict[str, dict[int, tuple[float | None, str | None]]]:
    """The occupied priorities of the actuators that have any."""
    arrays = bus.priorities("office")
    assert all(len(array) == 16 for array in arrays.values())
    occupied = {
        name: {p: (e.value, e.source) for p, e in enumerate(array, 1) if e.value is not None}
        for name, array in arrays.items()
    }
    return {name: entries for name, entries in occupied.items() if entries}


@pytest.mark.slow
def test_priorities__writes_and_commands_are_shown_at_their_priorities_at_once(episode_bus: Bus) -> None:
    assert _entries(episode_bus) == {}
    episode_bus.write("office", COOLING, 26.0, source="panel")
    episode_bus.write("office", COOLING, 27.5, priority=12, source="night")
    assert _entries(episode_bus) == {COOLING: {8: (26.0, "panel"), 12: (27.5, "night")}}
    with episode_bus.controller("office", name="mine", priority=10, actuators=[COOLING, HEATING]) as link:
        sample = next(iter(link))
        sample.send({COOLING: 24.0, HEATING: 20.0})
        next(iter(link))  # the timestep in which the command took effect is over
        shown = _entries(episode_bus)
        assert shown[COOLING] == {8: (26.0, "panel"), 10: (24.0, link.name), 12: (27.5, "night")}
        assert shown[HEATING] == {10: (20.0, link.name)}
    episode_bus.write("office", COOLING, None, source="panel")
    assert 8 not in _entries(episode_bus)[COOLING]
    with pytest.raises(UnknownName, match="no slot 1"):
        episode_bus.priorities("office", slot=1)


@pytest.mark.slow
def test_priorities__command_lists_the_effective_value_first(episode_bus: Bus) -> None:
    episode_bus.write("office", COOLING, 27.5, priority=12, source="night")
    episode_bus.write("office", COOLING, 26.0, source="panel")
    command = ["priorities", "office", COOLING, "--connect", episode_bus.endpoint]
    rows = json.loads(run_in_process(*command, "--json").stdout)
    assert [(row["priority"], row["value"], row["unit"], row["source"]) for row in rows] == [
        (8, 26.0, "degC", "panel"),
        (12, 27.5, "degC", "night"),
    ]
    lines = [line.split() for line in run_in_process(*command).stdout.splitlines() if COOLING in line]
    assert [line[1:3] for line in lines] == [["8", "26"], ["12", "27.5"]]
    assert COOLING in error_of("priorities", "office", "core_zn_coolin", "--connect", episode_bus.endpoint)
