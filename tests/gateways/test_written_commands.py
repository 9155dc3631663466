"""Commands that a gateway relinquishes when it ends."""

from zenostat.bridge.client.priorities import PriorityValue
from zenostat.gateways.written_commands import WrittenCommand, written_commands


def test_written_commands__are_those_of_the_source_and_below_it_whichever_process_wrote() -> None:
    def commands_of(source: str) -> list[WrittenCommand]:
        array = [PriorityValue(None, None)] * 7 + [PriorityValue(1.0, source)] + [PriorityValue(None, None)] * 8
        return written_commands({"heater": array}, "plant.modbus")

    for source in ("plant.modbus", "plant.modbus.panel"):
        assert commands_of(source) == [WrittenCommand("heater", 8, source)]
    for source in ("plant", "plant.modbus2", "modbus", "plant.mqtt"):
        assert commands_of(source) == []
