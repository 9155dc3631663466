"""A thermostat that speaks Modbus TCP and knows a building by its register map only. It needs `pip install pymodbus`.

    zenostat node --building ref-small-office --weather USA_CO_Denver --begin 07-03 --end 07-03 --name office --mode paced --speed 3600
    zenostat gateway modbus office --map map.csv
    zenostat gateway modbus office
    python examples/modbus_client.py map.csv

It raises the cooling setpoint of a zone while nobody is there, and relinquishes it when people come.
"""  # noqa: E501

from __future__ import annotations

import argparse
import csv
import struct
import time
from pathlib import Path

from pymodbus.client import ModbusTcpClient

TEMPERATURE, PEOPLE = "core_zn_air_temperature", "core_zn_occupants"
SETPOINT = "core_zn_cooling_setpoint"
UNOCCUPIED_DEGC = 28.0


def main() -> None:
    """Control the zone until the episode is over, or for a number of cycles."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("map", type=Path, help="register map, written by `zenostat gateway modbus NODE --map FILE.csv`")
    parser.add_argument("--port", type=int, default=1502)
    parser.add_argument("--cycles", type=int, default=0, help="0: until the episode is over")
    parser.add_argument("--pause", type=float, default=0.5, help="seconds between cycles")
    arguments = parser.parse_args()
    rows = list(csv.DictReader(arguments.map.read_text().splitlines()))
    address = {(row["table"], row["name"]): int(row["address"]) for row in rows}
    with ModbusTcpClient("127.0.0.1", port=arguments.port) as client:

        def read(name: str) -> float:
            reply = client.read_input_registers(address["input register", name], count=2)
            if reply.isError():
                raise SystemExit(f"{name}: {reply}")
            return struct.unpack(">f", struct.pack(">HH", *reply.registers))[0]

        def is_commanded() -> bool:
            return client.read_coils(address["coil", SETPOINT], count=1).bits[0]

        def is_effective() -> bool:
            """Return whether the command was in effect in the latest timestep, not another one of higher priority."""
            return client.read_discrete_inputs(address["discrete input", SETPOINT], count=1).bits[0]

        cycle = 0
        while client.read_discrete_inputs(address["discrete input", "episode_running"], count=1).bits[0]:
            temperature, people = read(TEMPERATURE), read(PEOPLE)
            if people == 0 and not is_commanded():
                words = list(struct.unpack(">HH", struct.pack(">f", UNOCCUPIED_DEGC)))
                client.write_registers(address["holding register", SETPOINT], words)
            elif people > 0 and is_commanded():
                client.write_coil(address["coil", SETPOINT], value=False)
            effect = "in effect" if is_effective() else "not in effect"
            setpoint = f"raised, {effect}" if is_commanded() else "of the building"
            print(f"{temperature:.2f} degC, {people:g} people, setpoint {setpoint}")
            cycle += 1
            if cycle == arguments.cycles:
                break
            time.sleep(arguments.pause)


if __name__ == "__main__":
    main()
