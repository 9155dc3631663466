"""The engine: EnergyPlus in a process of its own, exchanging one frame a timestep over sockets.

Run as `python -m eplus_node.engine ORDERS FRAMES PARENT`: two descriptors and the node's process id. No Zenoh, no
NumPy, no threads: a process like this can be forked while it waits.
"""

from __future__ import annotations

import ctypes
import json
import os
import socket
from array import array
from itertools import repeat
from math import isfinite
from typing import Any, NoReturn

from bridge.runtime.polling import Polling
from eplus_node.engine.fork import begin, clone, die_with_parent, leave, own_files
from eplus_node.engine.memory import SaturationCache, collapse_huge_pages
from eplus_node.engine.protocol import PROCESS_ID, FrameKind, OrderKind

RUN_PERIOD = 3
"""EnergyPlus's `kind_of_sim` of a weather-file run period."""

_OFTEN = 4

# Plain numbers for each timestep: Python 3.11 looks at an enum's member by raising and catching an error.
_SAMPLE, _STEP, _FORK = float(FrameKind.SAMPLE), float(OrderKind.STEP), float(OrderKind.FORK)


class Engine:
    """One simulation and its exchange."""

    def __init__(self, link: socket.socket, frames: socket.socket, spec: dict[str, Any]) -> None:
        from pyenergyplus.api import EnergyPlusAPI

        self.link, self.frames = link, frames
        self.spec = spec
        self.api = EnergyPlusAPI()
        self.state = self.api.state_manager.new_state()
        self.api.runtime.set_console_output_status(self.state, False)
        for variable, key, *_ in spec["sensors"]:
            self.api.exchange.request_variable(self.state, variable, key)
        for variable, key in spec["feedback"]:
            self.api.exchange.request_variable(self.state, variable, key)
        self._bind_library()
        self.step = 0
        self.steps = int(spec["steps"])
        self.steps_per_hour = int(spec["steps_per_hour"])
        self.zone_steps = 0
        self.zone_step_min = 0.0
        self.minute = 0.0
        self.in_run_period = False  # in the run period, warm-up included
        self.warmed_up = False  # after the warm-up
        self.finishing = False
        self.forked, self.forks = False, 0
        self.saturation = SaturationCache.shrink(self.state)
        self.out = array("d", [0.0]) * (2 + len(spec["sensors"]) + len(spec["meters"]) + len(spec["feedback"]))
        self.command = array("d", [0.0]) * (2 + len(spec["actuators"]))
        self.command_bytes = memoryview(self.command).cast("B")
        self.command_buffers = [self.command_bytes]
        self.descriptor, self.frames_descriptor = link.fileno(), frames.fileno()
        self.polling = Polling(enabled=spec["poll"])
        self.out_size = len(self.out) * self.out.itemsize
        how = [(aggregation, system) for _, _, aggregation, system in spec["sensors"]]
        # Variables of the zone kind have one value a zone timestep; only the others are gathered.
        self.averaged = [i for i, (aggregation, system) in enumerate(how) if system and aggregation != "instant"]
        self.summed = [how[i][0] == "sum" for i in self.averaged]
        self.totals: list[float] = []
        self.warmup_totals: list[float] = []

    def _bind_library(self) -> None:
        # PyDLL: the getters take a fraction of a microsecond and nobody else wants the GIL.
        library = ctypes.PyDLL(self.api.api._name)
        pointer, integer, real = ctypes.c_void_p, ctypes.c_int, ctypes.c_double

        def bind(name: str, result: Any, *arguments: Any) -> Any:
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
            return function

        self.get_variable = bind("getVariableValue", real, pointer, integer)
        self.get_meter = bind("getMeterValue", real, pointer, integer)
        self.set_actuator = bind("setActuatorValue", None, pointer, integer, real)
        self.reset_actuator = bind("resetActuator", None, pointer, integer)
        self.system_step_h = bind("systemTimeStep", real, pointer)
        self.zone_step_h = bind("zoneTimeStep", real, pointer)

    def run(self) -> NoReturn:
        """Simulates to the end, or as far as the node wants it, and leaves the process."""
        runtime = self.api.runtime
        runtime.callback_begin_new_environment(self.state, self._guarded(self._on_environment))
        runtime.callback_after_new_environment_warmup_complete(self.state, self._guarded(self._on_warm))
        if self.averaged:
            runtime.callback_end_system_timestep_after_hvac_reporting(self.state, self._guarded(self._on_system_step))
        runtime.callback_end_zone_timestep_after_zone_reporting(self.state, self._guarded(self._on_zone_step))
        spec = self.spec
        code = runtime.run_energyplus(self.state, ["-w", spec["weather"], "-d", spec["folder"], spec["model"]])
        if code != 0:
            self.fail(f"EnergyPlus ended with code {code}")
        if self.step < self.steps and not self.finishing:
            self.fail(f"EnergyPlus ended the run after {self.step} of {self.steps} timesteps")
        if not self.finishing:
            self.out[0] = FrameKind.LAST
            self.frames.sendall(self.out)
        leave(0)

    def _guarded(self, callback: Any) -> Any:
        # ctypes would print an exception and go on with the simulation.
        def guarded(state: int) -> None:
            try:
                callback(state)
            except Exception as error:
                self.fail(f"{type(error).__name__}: {error}")

        return guarded

    def fail(self, text: str) -> NoReturn:
        """Says why and leaves."""
        raw = text.encode()
        self.out[0], self.out[1] = FrameKind.FAILED, len(raw)
        try:
            self.frames.sendall(self.out)
            self.frames.sendall(raw)
        except OSError:
            leave(0)  # the node is gone; there is nobody to tell
        os._exit(1)  # the node reads eplusout.err and clears the folder

    def _on_environment(self, state: int) -> None:
        if self.api.exchange.kind_of_sim(state) != RUN_PERIOD:
            return
        self._find_handles(state)
        self.zone_step_min = self.zone_step_h(state) * 60.0
        self.in_run_period = True

    def _find_handles(self, state: int) -> None:
        exchange, spec = self.api.exchange, self.spec
        self.sensors = [exchange.get_variable_handle(state, v, k) for v, k, *_ in spec["sensors"]]
        self.feedback = [exchange.get_variable_handle(state, v, k) for v, k in spec["feedback"]]
        self.actuators = [exchange.get_actuator_handle(state, *names) for names in spec["actuators"]]
        # EnergyPlus 25.2 answers -1 for the first meter in its list, though reading index 0 works
        # (getMeterHandle takes 0 for "not found"); the survey gives the index of each.
        self.meters = [int(handle) for _, handle in spec["meters"]]
        for (name, handle), found in zip(spec["meters"], self.meters, strict=True):
            said = exchange.get_meter_handle(state, name)
            if said != found and not (found == 0 and said == -1):
                raise LookupError(f"meter {name!r} has handle {said}, {handle} expected")
        wanted = [*spec["sensors"], *spec["feedback"], *spec["actuators"]]
        for names, found in zip(wanted, [*self.sensors, *self.feedback, *self.actuators], strict=True):
            if found < 0:
                raise LookupError(f"EnergyPlus has no {' / '.join(map(str, names))} in this run")
        self.averaged_handles = [self.sensors[i] for i in self.averaged]

    def _on_system_step(self, state: int) -> None:
        """Gathers means and sums as EnergyPlus's reports do: value times its share of the zone timestep."""
        if not self.in_run_period:
            return
        # EnergyPlus weighs by differences of the minute within the hour, whose rounding goes on from step to
        # step until the hour ends: only so the sum is the same to the last bit.
        end = self.minute + self.system_step_h(state) * 60.0
        share = (end - self.minute) / self.zone_step_min
        self.minute = end
        if share == 1.0 and not self.totals:
            return  # one system timestep fills the zone timestep: its value is read at the end
        values = map(self.get_variable, repeat(state), self.averaged_handles)
        parts = [v if s else v * share for v, s in zip(values, self.summed, strict=True)]
        self.totals = [a + b for a, b in zip(self.totals, parts, strict=True)] if self.totals else parts

    def _gather(self, state: int) -> None:
        values = list(map(self.get_variable, repeat(state), self.sensors))
        if self.totals:
            for place, total in zip(self.averaged, self.totals, strict=True):
                values[place] = total
            self.totals = []
        if self.step:
            values.extend(map(self.get_meter, repeat(state), self.meters))
        else:
            values.extend([0.0] * len(self.meters))  # nothing has been metered yet
        values.extend(map(self.get_variable, repeat(state), self.feedback))
        if not isfinite(sum(values)):
            self._refuse_strange(values)
        self.out[2:] = array("d", values)

    def _refuse_strange(self, values: list[float]) -> None:
        spec = self.spec
        names = [*spec["sensors"], *spec["meters"], *spec["feedback"]]
        for names_of, value in zip(names, values, strict=True):
            if not isfinite(value):
                raise ArithmeticError(
                    f"EnergyPlus gives {value} for {names_of[0]!r} {names_of[1]!r} at step {self.step}"
                )

    def _on_warm(self, state: int) -> None:
        if self.in_run_period and not self.warmed_up:
            self.warmed_up = True
            self.totals = self.warmup_totals
            self._gather(state)
            self._exchange(state)

    def _on_zone_step(self, state: int) -> None:
        if self.in_run_period:
            self.zone_steps += 1
            if self.zone_steps % self.steps_per_hour == 0:
                self.minute = 0.0
        if not self.warmed_up:
            self.warmup_totals, self.totals = self.totals, []
            return
        if self.finishing:
            return
        self.step += 1
        if self.step > self.steps:
            raise RuntimeError(f"EnergyPlus simulates more than the {self.steps} timesteps of the run period")
        self._gather(state)
        if self.step < self.steps:
            self._exchange(state)
            return
        self.out[1] = self.step  # sent by run(), once EnergyPlus has ended well
        if self.spec["branch"]:  # its end would write into the folder of the one it was forked from
            self.out[0] = FrameKind.LAST
            self.frames.sendall(self.out)
            leave(0)

    def _exchange(self, state: int) -> None:
        """Sends the sample, waits for the order, and sets or releases each actuator."""
        out, command = self.out, self.command
        out[0], out[1] = _SAMPLE, self.step
        size = len(self.command_bytes)
        while True:
            try:
                written = os.write(self.frames_descriptor, out)
                if written < self.out_size:
                    self.frames.sendall(memoryview(out).cast("B")[written:])
                got = self.polling.wait(self._try_read, self._read)
                while got and got < size:
                    more = self.link.recv_into(self.command_bytes[got:])
                    got = got + more if more else 0
            except ConnectionError:
                got = 0
            if not got:
                leave(0)  # the node has gone or wants no more of this run
            if command[0] != _FORK:
                break
            self._fork()  # both then tell the sample that they stand at: the child its first, the parent again
        if command[0] != _STEP:
            self.finishing = True
            self.api.runtime.stop_simulation(state)
            return
        set_actuator = self.set_actuator
        for handle, value in zip(self.actuators, command[2:], strict=True):
            if value == value:
                set_actuator(state, handle, value)
            else:
                self.reset_actuator(state, handle)

    def _fork(self) -> None:
        """Becomes two: the child goes on with the sockets and the folder that the node hands over."""
        length = int(self.command[1])
        raw, descriptors, _, _ = socket.recv_fds(self.link, length, 2)
        told = json.loads(raw)
        link, frames = (socket.socket(fileno=descriptor) for descriptor in descriptors)
        self.forks += 1
        # One that has gone on from a fork has its memory in small pages; that only matters if it is forked often.
        if self.forked and self.forks >= _OFTEN and self.forks & (self.forks - 1) == 0:
            collapse_huge_pages()
        try:
            child = clone()
        except OSError as error:
            child = -(error.errno or 1)
        if child:
            link.close()
            frames.close()
            self.frames.sendall(PROCESS_ID.pack(child))
            return
        die_with_parent(told["parent"])  # at once: whatever comes next may take a while
        self.spec = spec = self.spec | told
        self.forked, self.forks = True, 0
        self.link.close()
        self.frames.close()
        self.link, self.frames = link, frames
        self.descriptor, self.frames_descriptor = link.fileno(), frames.fileno()
        self.polling = Polling(enabled=spec["poll"])
        self.frames.sendall(PROCESS_ID.pack(os.getpid()))
        begin(spec)
        own_files(spec["folder"])
        if self.saturation:
            self.saturation.reset()

    def _try_read(self) -> int | None:
        try:
            return self.link.recv_into(self.command_bytes, 0, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None

    def _read(self) -> int:
        return os.readv(self.descriptor, self.command_buffers)
