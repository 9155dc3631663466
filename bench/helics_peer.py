"""HELICS as a peer: two federates in two processes that exchange a command and a measurement in each step.

`python -m bench.helics_peer CORE PORT OFFSET_S` is the plant's federate; `Controller` is the other one and has the
broker. Both publish a value, request their next time and read the other's value. With an offset of half a step the
plant's time lies between two of the controller's, so that a measurement shows the command of the same step, as that of
`env.step` does. Without an offset, both request the same times at once, and it shows the command before.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from contextlib import suppress
from typing import Any

from bench import programs

STEP_S = 1.0
COMMAND, MEASURED = "command", "measured"


def installed() -> bool:
    """Return whether HELICS can be imported (`pip install helics`)."""
    return importlib.util.find_spec("helics") is not None


def _federate(name: str, publishes: str, reads: str, core: str, port: int, offset_s: float) -> tuple[Any, Any, Any]:
    """Return a federate that is executing, its publication and its input."""
    import helics

    info = helics.helicsCreateFederateInfo()
    helics.helicsFederateInfoSetCoreTypeFromString(info, core)
    helics.helicsFederateInfoSetCoreInitString(info, f"--federates=1 --brokerport={port}")
    helics.helicsFederateInfoSetTimeProperty(info, helics.helics_property_time_period, STEP_S)
    helics.helicsFederateInfoSetTimeProperty(info, helics.helics_property_time_offset, offset_s)
    federate = helics.helicsCreateValueFederate(name, info)
    publication = helics.helicsFederateRegisterGlobalPublication(federate, publishes, helics.HELICS_DATA_TYPE_DOUBLE)
    value = helics.helicsFederateRegisterSubscription(federate, reads)
    helics.helicsFederateEnterExecutingMode(federate)
    return federate, publication, value


class Controller:
    """The controller's federate, with a broker and the plant in a process of its own.

    Args:
        core: HELICS's core type, such as `tcp` or `zmq`.
        offset_s: of the plant's times.
    """

    def __init__(self, core: str, offset_s: float) -> None:
        import helics

        port = programs.free_port()
        self._helics, self._offset_s = helics, offset_s
        self._broker = helics.helicsCreateBroker(core, "", f"--federates=2 --port={port}")
        plant = programs.command("helics_peer", core, str(port), str(offset_s))
        self._plant = subprocess.Popen(plant, stdin=subprocess.DEVNULL, env=programs.environment())
        self._federate, self._publication, self._input = _federate("controller", COMMAND, MEASURED, core, port, 0.0)
        self._time_s = self._value = 0.0

    def step(self) -> None:
        """Publish a command, wait for the next time, and read the measurement; check that it is the right one."""
        helics, previous = self._helics, self._value
        self._value += 1.0
        helics.helicsPublicationPublishDouble(self._publication, self._value)
        self._time_s = helics.helicsFederateRequestTime(self._federate, self._time_s + STEP_S)
        measured = helics.helicsInputGetDouble(self._input)
        expected = self._value if self._offset_s else previous
        if previous and measured != expected:
            raise RuntimeError(f"HELICS: measured {measured} at {self._time_s} s, expected {expected}")

    def close(self) -> None:
        """End both federates."""
        self._plant.kill()
        self._plant.wait()


def _serve(core: str, port: int, offset_s: float) -> None:
    import helics

    federate, publication, value = _federate("plant", MEASURED, COMMAND, core, port, offset_s)
    time_s = 0.0
    while True:
        time_s = helics.helicsFederateRequestTime(federate, time_s + STEP_S)
        helics.helicsPublicationPublishDouble(publication, helics.helicsInputGetDouble(value))


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        _serve(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
