"""The engine: EnergyPlus in a process of its own that exchanges one frame per timestep with its node.

`python -m zenostat.eplus_node.engine` runs it; `protocol.py` describes the frames. It imports neither Zenoh nor NumPy
and starts no thread, so that the process can be forked while it waits.
"""

from __future__ import annotations

import ctypes
import os
import socket
from array import array
from collections.abc import Iterable
from itertools import repeat
from math import isfinite
from operator import itemgetter
from typing import Any, NoReturn

from zenostat.bridge.engine.protocol import PROCESS_ID, FrameKind, OrderKind
from zenostat.bridge.engine.system_calls import fork_with_sockets, leave, reopen_files, replace_file, set_up_process
from zenostat.bridge.runtime.polling import Polling
from zenostat.eplus_node.engine.huge_pages import collapse_huge_pages
from zenostat.eplus_node.engine.memory import SaturationCache
from zenostat.eplus_node.engine.severe_errors import SevereErrors
from zenostat.models.engine_library import key_pattern, new_api

RUN_PERIOD = 3
"""EnergyPlus's `kind_of_sim` for a run period that reads a weather file."""

OUTDOOR_TEMPERATURE = ("Weather Data", "Outdoor Dry Bulb", "Environment")
"""The actuator that overrides the outdoor temperature of the weather file."""

_EMS_KEY = "ems"
"""EnergyPlus's key of the output variables of EMS programs, case-folded."""

_FORKS_BEFORE_COLLAPSE = 4

_MINUTE_TOLERANCE = 0.01
"""In minutes: rounding errors are smaller, and a system timestep has at least one minute."""

_STEP_TOLERANCE = 1e-6

# Plain numbers on the hot path: in Python 3.11, looking up an enum's member raises and catches an error.
_SAMPLE, _STEP = float(FrameKind.SAMPLE), float(OrderKind.STEP)
_FORK, _REPEAT = float(OrderKind.FORK), float(OrderKind.REPEAT)


class Engine:
    """One simulation and its exchange with the node.

    Args:
        orders: the socket on which the node's orders arrive.
        frames: the socket to which frames are sent.
        spec: the fields of an `EngineSpec`.
    """

    def __init__(self, orders: socket.socket, frames: socket.socket, spec: dict[str, Any]) -> None:
        self.orders, self.frames = orders, frames
        self.spec = spec
        self.api = new_api()
        self.state = self.api.state_manager.new_state()
        self.api.runtime.set_console_output_status(self.state, False)
        for variable, key, *_ in spec["sensors"]:
            self.api.exchange.request_variable(self.state, variable, key_pattern(key))
        for variable, key in spec["feedback"]:
            self.api.exchange.request_variable(self.state, variable, key_pattern(key))
        self._bind_library()
        self.step = 0
        self.steps = int(spec["steps"])
        self.steps_per_hour = int(spec["steps_per_hour"])
        self.zone_steps = 0
        self.zone_step_min = 0.0
        self.zone_end_min = 0.0  # both within the hour
        self.minute = 0.0
        self.in_run_period = False  # including its warm-up
        self.warmed_up = False
        self.finishing = False
        self.forked, self.forks = False, 0
        self.forecast_error: list[float] = []
        self.forecast_begin, self.outdoor_handle = 0, -1
        self.saturation = SaturationCache.shrink(self.state) if spec["shrink_caches"] else None
        self.out = array("d", [0.0]) * (2 + len(spec["sensors"]) + len(spec["meters"]) + len(spec["feedback"]))
        self.command = array("d", [0.0]) * (2 + len(spec["actuators"]))
        self.command_bytes = memoryview(self.command).cast("B")
        self.command_buffers = [self.command_bytes]
        self.orders_descriptor, self.frames_descriptor = orders.fileno(), frames.fileno()
        self.polling = Polling(enabled=spec["poll"])
        self.out_size = len(self.out) * self.out.itemsize
        kinds = [(aggregation, system) for _, _, aggregation, system in spec["sensors"]]
        # Variables of the zone kind have one value per zone timestep; only the others are aggregated.
        self.zone_sensors = [i for i, (_, system) in enumerate(kinds) if not system]
        self.aggregated = [i for i, (aggregation, system) in enumerate(kinds) if system and aggregation != "instant"]
        self.states = [i for i, (aggregation, system) in enumerate(kinds) if system and aggregation == "instant"]
        self.summed = [kinds[i][0] == "sum" for i in self.aggregated]
        read = [*self.zone_sensors, *self.aggregated, *self.states]
        order = sorted(range(len(read)), key=read.__getitem__)
        # From the order of reading to that of the sensors.
        self.arrange: Any = itemgetter(*order) if len(order) > 1 else tuple
        self.totals: list[float] = []
        # Of the latest zone timestep: means and sums, then states; empty if they are read at its end.
        self.system_values: list[float] = []
        self.scheduled = spec["scheduled"]
        self.severe_errors = SevereErrors()
        self.has_program_variables = any(key.casefold() == _EMS_KEY and system for _, key, _, system in spec["sensors"])

    def _bind_library(self) -> None:
        # PyDLL keeps the GIL: the getters take a fraction of a microsecond and there is no other thread.
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
        """Simulate until the run period or the node ends the run, then exit the process."""
        runtime = self.api.runtime
        runtime.callback_begin_new_environment(self.state, self._guarded(self._on_environment))
        runtime.callback_after_new_environment_warmup_complete(self.state, self._guarded(self._on_warmed_up))
        if self.aggregated or self.has_program_variables:
            runtime.callback_end_system_timestep_after_hvac_reporting(self.state, self._guarded(self._on_system_step))
        runtime.callback_end_zone_timestep_after_zone_reporting(self.state, self._guarded(self._on_zone_step))
        self.api.functional.callback_error(self.state, self.severe_errors.add)
        spec = self.spec
        code = runtime.run_energyplus(self.state, ["-w", spec["weather"], "-d", spec["folder"], spec["model"]])
        if code != 0:
            self.fail(f"EnergyPlus ended with code {code}")
        if self.step < self.steps and not self.finishing:
            self.fail(f"EnergyPlus ended the run after {self.step} of {self.steps} timesteps")
        if not self.finishing:
            self._send_last()
        leave(0)

    def _send_last(self) -> None:
        self._send_warnings(self.severe_errors.drain())
        self.out[0], self.out[1] = FrameKind.LAST, self.step
        self.frames.sendall(self.out)

    def _repeat_warnings(self) -> None:
        if not self.step:  # another episode begins here
            self._send_warnings(self.severe_errors.repeat())

    def _send_warnings(self, texts: Iterable[str]) -> None:
        for text in texts:
            raw = text.encode()
            self.out[0], self.out[1] = FrameKind.WARNING, len(raw)
            self.frames.sendall(self.out)
            self.frames.sendall(raw)

    def _guarded(self, callback: Any) -> Any:
        # ctypes would print an exception and continue the simulation.
        def guarded(state: int) -> None:
            try:
                callback(state)
            except Exception as error:
                self.fail(f"{type(error).__name__}: {error}")

        return guarded

    def fail(self, text: str) -> NoReturn:
        """Send the error to the node and exit."""
        raw = text.encode()
        self.out[0], self.out[1] = FrameKind.FAILED, len(raw)
        try:
            self.frames.sendall(self.out)
            self.frames.sendall(raw)
        except OSError:
            leave(0)  # the node has ended
        os._exit(1)  # the node reads eplusout.err and removes the folder

    def _on_environment(self, state: int) -> None:
        if self.api.exchange.kind_of_sim(state) != RUN_PERIOD:
            return
        hours = self.zone_step_h(state)
        if abs(hours * self.steps_per_hour - 1.0) > _STEP_TOLERANCE:
            self.fail(f"EnergyPlus takes {1.0 / hours:g} instead of {self.steps_per_hour} timesteps per hour")
        self._find_handles(state)
        self.zone_step_min = self.zone_end_min = hours * 60.0
        self.in_run_period = True

    def _find_handles(self, state: int) -> None:
        exchange, spec = self.api.exchange, self.spec
        self.sensors = [exchange.get_variable_handle(state, v, k) for v, k, *_ in spec["sensors"]]
        self.feedback = [exchange.get_variable_handle(state, v, k) for v, k in spec["feedback"]]
        self.actuators = [exchange.get_actuator_handle(state, *names) for names in spec["actuators"]]
        # EnergyPlus 25.2 returns -1 for the first meter in its list, although reading index 0 works (getMeterHandle
        # treats 0 as "not found"), and for a name with a small letter beyond ASCII; the discovery of points provides
        # the index of each.
        for name, expected in (part for _, parts in spec["meters"] for part in parts):
            handle = exchange.get_meter_handle(state, name)
            if handle != expected and not (handle == -1 and (expected == 0 or not name.isascii())):
                raise LookupError(f"meter {name!r} has handle {handle}, expected {expected}")
        handles = [[int(handle) for _, handle in parts] for _, parts in spec["meters"]]
        self.meters = [first for first, *_ in filter(None, handles)]
        # Index in the frame, and the handles to add to what the first meter gives; a sum of none is 0.
        self.meter_sums = [(i, rest) for i, (_, *rest) in enumerate(filter(None, handles), len(self.sensors)) if rest]
        self.zero_meters = [i for i, parts in enumerate(handles, len(self.sensors)) if not parts]
        points = [*spec["sensors"], *spec["feedback"], *spec["actuators"]]
        for names, handle in zip(points, [*self.sensors, *self.feedback, *self.actuators], strict=True):
            if handle < 0:
                raise LookupError(f"EnergyPlus has no {' / '.join(map(str, names))} in this run")
        self.zone_handles = [self.sensors[i] for i in self.zone_sensors]
        self.aggregated_handles = [self.sensors[i] for i in self.aggregated]
        self.system_handles = [self.sensors[i] for i in [*self.aggregated, *self.states]]

    def _on_system_step(self, state: int) -> None:
        """Read system variables as EnergyPlus has just reported them; add to means and sums as its reports do.

        An EMS program may change its output variables right after this report; EnergyPlus reports that change in the
        next system timestep. At the end of the zone timestep, they would be a step ahead. All other system variables
        keep their values until then.
        """
        if not self.in_run_period:
            return
        # EnergyPlus computes weights from differences of the minute within the hour, whose rounding errors carry
        # over from step to step until the hour ends. Only the same arithmetic gives the same sum to the last bit.
        end = self.minute + self.system_step_h(state) * 60.0
        share = (end - self.minute) / self.zone_step_min
        self.minute = end
        if share == 1.0 and not self.has_program_variables:
            self.system_values = []  # read with the zone variables: one visit to EnergyPlus takes less time than two
            return
        if end < self.zone_end_min - _MINUTE_TOLERANCE:
            self.totals = self._totals(map(self.get_variable, repeat(state), self.aggregated_handles), share)
            return
        values = list(map(self.get_variable, repeat(state), self.system_handles))
        if share != 1.0:
            count = len(self.aggregated)
            values[:count] = self._totals(values[:count], share)
            self.totals = []
        self.system_values = values

    def _totals(self, values: Iterable[float], share: float) -> list[float]:
        parts = [v if s else v * share for v, s in zip(values, self.summed, strict=True)]
        return [a + b for a, b in zip(self.totals, parts, strict=True)] if self.totals else parts

    def _gather(self, state: int) -> None:
        if self.system_values:
            zone_values = map(self.get_variable, repeat(state), self.zone_handles)
            values = list(self.arrange([*zone_values, *self.system_values]))
        else:
            values = list(map(self.get_variable, repeat(state), self.sensors))
        for index, column in self.scheduled:
            values[index] = column[self.step]
        if self.step:
            values.extend(map(self.get_meter, repeat(state), self.meters))
            for index, handles in self.meter_sums:
                for handle in handles:  # `sum` rounds differently from Python 3.12 on
                    values[index] += self.get_meter(state, handle)
        else:
            values.extend([0.0] * len(self.meters))  # meters start with the first timestep
        for index in self.zero_meters:
            values.insert(index, 0.0)
        values.extend(map(self.get_variable, repeat(state), self.feedback))
        if not isfinite(sum(values)):
            self._raise_not_finite(values)
        self.out[2:] = array("d", values)

    def _raise_not_finite(self, values: list[float]) -> None:
        spec = self.spec
        points = [*spec["sensors"], *spec["meters"], *spec["feedback"]]
        for (name, key, *_), value in zip(points, values, strict=True):
            if not isfinite(value):
                raise ArithmeticError(f"EnergyPlus reports {value} for {name!r} {key!r} at step {self.step}")

    def _on_warmed_up(self, state: int) -> None:
        if self.in_run_period and not self.warmed_up:
            self.warmed_up = True
            self._gather(state)
            self._exchange(state)

    def _on_zone_step(self, state: int) -> None:
        if self.in_run_period:
            self.zone_steps += 1
            in_hour = self.zone_steps % self.steps_per_hour
            if not in_hour:
                self.minute = 0.0
            self.zone_end_min = (in_hour + 1) * self.zone_step_min
        if not self.warmed_up:
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
        # Sent by run(), once EnergyPlus has ended without an error.
        if self.spec["branch"]:  # EnergyPlus's end of run would write into the folder of the forked engine
            self._send_last()
            leave(0)

    def _exchange(self, state: int) -> None:
        """Send the sample, wait for an order, and set or relinquish each actuator."""
        out, command = self.out, self.command
        size = len(self.command_bytes)
        while True:
            try:
                if self.severe_errors.lines:
                    self._send_warnings(self.severe_errors.drain())
                out[0], out[1] = _SAMPLE, self.step
                written = os.write(self.frames_descriptor, out)
                if written < self.out_size:
                    self.frames.sendall(memoryview(out).cast("B")[written:])
                got = self.polling.wait(self._try_read, self._read)
                while got and got < size:
                    more = self.orders.recv_into(self.command_bytes[got:])
                    got = got + more if more else 0
            except ConnectionError:
                got = 0
            if not got:
                leave(0)  # the node has ended, or has closed this run
            kind = command[0]
            if kind == _STEP:
                self._apply(state, command[2:])
                return
            if kind == _FORK:
                self._fork()  # parent and child then both send the sample at which they wait
            elif kind == _REPEAT:
                self._repeat_warnings()
            else:
                self.finishing = True
                self.api.runtime.stop_simulation(state)
                return

    def _apply(self, state: int, values: array[float]) -> None:
        set_actuator = self.set_actuator
        for handle, value in zip(self.actuators, values, strict=True):
            if value == value:
                set_actuator(state, handle, value)
            else:
                self.reset_actuator(state, handle)
        if self.forecast_error:
            self._disturb_weather(state)

    def _disturb_weather(self, state: int) -> None:
        """Set the outdoor temperature of the next timestep to that of the weather file plus the forecast error."""
        exchange, errors = self.api.exchange, self.forecast_error
        if self.outdoor_handle < 0:
            self.outdoor_handle = exchange.get_actuator_handle(state, *OUTDOOR_TEMPERATURE)
        step = self.step % (24 * self.steps_per_hour)
        hour, number = divmod(step, self.steps_per_hour)
        # After a day's last timestep, EnergyPlus still has this day as today.
        weather = exchange.tomorrow_weather_outdoor_dry_bulb_at_time if self.step and not step else None
        weather = weather or exchange.today_weather_outdoor_dry_bulb_at_time
        error = errors[min(self.step - self.forecast_begin, len(errors) - 1)]
        self.set_actuator(state, self.outdoor_handle, weather(state, hour, number + 1) + error)

    def _fork(self) -> None:
        """Fork the process; the child continues with the sockets and the folder that the node sent."""
        self.forks += 1
        # A forked engine that has simulated has its memory in small pages, which only matters if it is forked often.
        if self.forked and self.forks >= _FORKS_BEFORE_COLLAPSE and self.forks & (self.forks - 1) == 0:
            collapse_huge_pages()
        if (forked := fork_with_sockets(self.orders, self.frames, int(self.command[1]))) is None:
            return
        child_fields, orders, frames = forked
        self.spec = spec = self.spec | child_fields
        self.forked, self.forks = True, 0
        self.forecast_error, self.forecast_begin = spec["forecast_error"], self.step
        self.orders, self.frames = orders, frames
        self.orders_descriptor, self.frames_descriptor = orders.fileno(), frames.fileno()
        self.polling = Polling(enabled=spec["poll"])
        self.frames.sendall(PROCESS_ID.pack(os.getpid()))
        set_up_process(spec)
        reopen_files(spec["folder"])
        if spec["replaced_file"]:
            replace_file(*spec["replaced_file"])
        if self.saturation:
            self.saturation.reset()
        self._repeat_warnings()

    def _try_read(self) -> int | None:
        try:
            return self.orders.recv_into(self.command_bytes, 0, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None

    def _read(self) -> int:
        return os.readv(self.orders_descriptor, self.command_buffers)
