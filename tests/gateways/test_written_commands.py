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
    written = WrittenCommands()
    for source in ("mqtt.anna", "mqtt.ben"):
        with written.sending("heater", 8, source):
            pass
    with pytest.raises(RequestRejected), written.sending("heater", 8, "mqtt.carl"):
        raise RequestRejected("claimed")
    for source in ("mqtt.anna", "mqtt.ben"):
        assert remaining(written, source) == [WrittenCommand("heater", 8, source)]
    assert remaining(written, "mqtt.carl") == remaining(written, "operator") == []


def test_written_commands__oldest_source_is_forgotten_first() -> None:
    written = WrittenCommands()
    for number in (*range(MAX_SOURCES), 0, MAX_SOURCES):
        with written.sending("heater", 8, f"s{number}"):
            pass
    assert [bool(remaining(written, f"s{number}")) for number in (0, 1, MAX_SOURCES)] == [True, False, True]
