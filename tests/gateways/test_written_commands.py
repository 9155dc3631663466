"""Commands that a gateway relinquishes when it ends."""

import pytest

from zenostat.bridge.client.priorities import PriorityValue
from zenostat.gateways.written_commands import MAX_SOURCES, WrittenCommand, WrittenCommands
from zenostat.topics.errors import RequestRejected


def remaining(written: WrittenCommands, source: str) -> list[WrittenCommand]:
    """The gateway's commands among those of a node where a source's is in force at priority 8."""
    array = [PriorityValue(None, None)] * 7 + [PriorityValue(1.0, source)] + [PriorityValue(None, None)] * 8
    return written.remaining({"heater": array})


def test_written_commands__replaced_one_that_a_snapshot_brings_back_remains() -> None:
    written = WrittenCommands("mqtt")
    for source in ("anna", "ben"):
        with written.sending("heater", 8, source):
            pass
    with pytest.raises(RequestRejected), written.sending("heater", 8, "carl"):
        raise RequestRejected("claimed")
    for source in ("anna", "ben"):
        assert remaining(written, source) == [WrittenCommand("heater", 8, source)]
    assert remaining(written, "carl") == remaining(written, "operator") == []


def test_written_commands__source_of_the_gateway_and_those_below_it_are_its_own_whichever_process_wrote() -> None:
    written = WrittenCommands("plant.modbus")
    for source in ("plant.modbus", "plant.modbus.panel"):
        assert remaining(written, source) == [WrittenCommand("heater", 8, source)]
    for source in ("plant", "plant.modbus2", "modbus", "plant.mqtt"):
        assert remaining(written, source) == []


def test_written_commands__oldest_source_is_forgotten_first() -> None:
    written = WrittenCommands("mqtt")
    for number in (*range(MAX_SOURCES), 0, MAX_SOURCES):
        with written.sending("heater", 8, f"s{number}"):
            pass
    assert [bool(remaining(written, f"s{number}")) for number in (0, 1, MAX_SOURCES)] == [True, False, True]
