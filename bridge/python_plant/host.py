"""Run a plant's class in a process of its own.

`python -m zenostat.bridge.python_plant.host ORDERS FRAMES PARENT` serves a node over two sockets; see
`zenostat.bridge.engine.protocol`.
`python -m zenostat.bridge.python_plant.host describe`, with a JSON object of plant and arguments on standard input,
prints its description, or the error.
"""

from __future__ import annotations

import dataclasses
import errno
import io
import json
import os
import pickle
import socket
import sys
import traceback
from array import array
from collections.abc import Mapping
from math import isnan, nan
from pathlib import Path
from typing import Any, NoReturn

from zenostat.bridge.engine.protocol import PROCESS_ID, FrameKind, OrderKind
from zenostat.bridge.engine.system_calls import (
    die_with_parent,
    fork_with_sockets,
    lead_session,
    leave,
    receive_spec,
    reopen_files,
    set_up_process,
)
from zenostat.bridge.python_plant.description import are_texts, create, describe, measured_number
from zenostat.bridge.runtime.polling import Polling
from zenostat.topics.errors import ZenostatError, did_you_mean, to_wire

_SAMPLE, _LAST, _STEP = float(FrameKind.SAMPLE), float(FrameKind.LAST), float(OrderKind.STEP)
_OWN_FILES = str(Path(__file__).parent)


class PlantError(Exception):
    """The plant's code raised an error, or returned values that are not valid; the text is for the user."""


def users_traceback(error: BaseException) -> str:
    """Return the traceback from the user's first frame on."""
    frames = error.__traceback__
    while frames is not None and frames.tb_frame.f_code.co_filename.startswith((_OWN_FILES, "<frozen importlib")):
        frames = frames.tb_next
    return "".join(traceback.format_exception(type(error), error, frames)).strip()


def close(plant: Any) -> None:
    """Let a plant release what it holds, if it can; print what it raises."""
    try:
        if callable(getattr(plant, "close", None)):
            plant.close()
    except BaseException as error:
        sys.stderr.write(f"{type(plant).__name__}.close() raised an error\n{users_traceback(error)}\n")


class PlantHost:
    """One instance of a plant's class and its exchange with the node.

    Args:
        orders: the socket on which the node's orders arrive.
        frames: the socket to which frames are sent.
        spec: the fields of an `EngineSpec`; its run has `plant`, `arguments`, the points, and `seed`.
    """

    def __init__(self, orders: socket.socket, frames: socket.socket, spec: dict[str, Any]) -> None:
        self._spec = spec
        self._values: list[str] = spec["values"]
        self._known = frozenset(self._values)
        self._actuators: list[tuple[str, float | None]] = [(name, default) for name, default in spec["actuators"]]
        self._out = array("d", [0.0]) * (2 + len(self._values) + len(self._actuators))
        self._order = array("d", [0.0]) * (2 + len(self._actuators))
        self._order_bytes = memoryview(self._order).cast("B")
        self._step = 0
        self._use(orders, frames, poll=spec["poll"])
        self._plant: Any = None
        self._warns = False

    def _use(self, orders: socket.socket, frames: socket.socket, *, poll: bool) -> None:
        self._orders, self._frames = orders, frames
        self._polling = Polling(enabled=poll)

    def run(self) -> NoReturn:
        """Serve the node until it closes the sockets."""
        try:
            self._plant = self._call("__init__", create, self._spec["plant"], self._spec["arguments"])
            self._warns = callable(getattr(self._plant, "drain_warnings", None))
            if self._spec["state"]:
                self._restore(Path(self._spec["state"]))
            else:
                self._reset(self._spec["seed"])
            self._send()
            while True:
                self._handle_order()
        except PlantError as error:
            self._fail(str(error))
        except ConnectionError:
            leave(0)  # the node has ended, or has closed this run

    def _call(self, method: str, function: Any, *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except ZenostatError as error:
            raise PlantError(str(error)) from None
        except BaseException as error:  # such as a SystemExit or a KeyboardInterrupt of the user's code
            raise PlantError(f"{self._name}.{method}() raised an error\n{users_traceback(error)}") from None

    @property
    def _name(self) -> str:
        return str(self._spec["plant"]).rpartition(":")[2]

    def _reset(self, seed: int) -> None:
        self._step = 0
        self._take("reset", self._call("reset", self._plant.reset, seed), {})

    def _take(self, method: str, values: Any, commands: Mapping[str, float]) -> None:
        """Take over the values that a method returned, and the commands that acted."""
        if not isinstance(values, Mapping) or values.keys() != self._known:
            raise PlantError(f"{self._name}.{method}() at step {self._step} {self._complaint(values)}")
        numbers = []
        for name in self._values:
            value = measured_number(values[name])
            if isnan(value):
                raise PlantError(
                    f"{self._name}.{method}() returned {values[name]!r} for {name!r} at step {self._step}; "
                    "a finite number expected"
                )
            numbers.append(value)
        numbers.extend(commands.get(name, nan if default is None else default) for name, default in self._actuators)
        self._out[2:] = array("d", numbers)

    def _complaint(self, values: Any) -> str:
        if not isinstance(values, Mapping):
            return f"returned {type(values).__name__}; a dict with the values of {', '.join(self._values)} expected"
        missing = [name for name in self._values if name not in values]
        if missing:
            return f"returned no value for {', '.join(map(repr, missing))}"
        unknown = next(name for name in values if name not in self._known)
        return (
            f"returned {unknown!r}, which is neither a sensor nor a meter; {did_you_mean(str(unknown), self._values)}"
        )

    def _send(self) -> None:
        if self._warns:
            self._send_warnings()
        self._out[0] = _LAST if self._step >= self._spec["steps"] else _SAMPLE
        self._out[1] = self._step
        self._frames.sendall(self._out)

    def _send_warnings(self) -> None:
        texts = self._call("drain_warnings", self._plant.drain_warnings)
        if not are_texts(texts):
            raise PlantError(f"{self._name}.drain_warnings() returned {texts!r}; a list of texts expected")
        for text in texts:
            raw = text.encode(errors="backslashreplace")
            self._out[0], self._out[1] = FrameKind.WARNING, len(raw)
            self._frames.sendall(self._out)
            self._frames.sendall(raw)

    def _handle_order(self) -> None:
        received = self._polling.wait(self._try_receive, self._receive)
        while received < len(self._order_bytes):
            more = self._orders.recv_into(self._order_bytes[received:]) if received else 0
            if not more:
                raise ConnectionResetError
            received += more
        kind = self._order[0]
        if kind == _STEP:
            self._simulate()
        elif kind == OrderKind.FORK:
            self._fork()
        elif kind == OrderKind.RESET:
            self._reset(json.loads(self._text())["seed"])
        elif kind == OrderKind.SAVE:
            self._save(Path(json.loads(self._text())["path"]))
            return
        elif kind == OrderKind.RESTORE:
            self._restore(Path(json.loads(self._text())["path"]))
        elif kind != OrderKind.REPEAT:
            close(self._plant)
            leave(0)
        self._send()

    def _try_receive(self) -> int | None:
        try:
            return self._orders.recv_into(self._order_bytes, 0, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None

    def _receive(self) -> int:
        return self._orders.recv_into(self._order_bytes)

    def _text(self) -> bytes:
        return self._orders.recv(int(self._order[1]), socket.MSG_WAITALL)

    def _simulate(self) -> None:
        commands = {}
        for (name, default), value in zip(self._actuators, self._order[2:], strict=True):
            if value == value:
                commands[name] = value
            elif default is not None:
                commands[name] = default
        self._step += 1
        acted = commands.copy()
        self._take("step", self._call("step", self._plant.step, commands), acted)

    # Copies

    def _save(self, path: Path) -> None:
        reply = 0
        try:
            state = self._call("save", self._plant.save)
            path.write_bytes(pickle.dumps((self._step, self._out.tolist()[2:], state)))
        except Exception as error:
            path.write_text(f"the state of {self._name} cannot be saved: {error}")
            reply = -1
        self._frames.sendall(PROCESS_ID.pack(reply))

    def _restore(self, path: Path) -> None:
        raw = path.read_bytes()  # written by `_save` of this node
        try:
            self._step, numbers, state = pickle.loads(raw)  # noqa: S301
        except Exception as error:  # whatever the user's classes raise
            raise PlantError(f"the state of {self._name}.save() cannot be loaded again: {error!r}") from None
        self._call("restore", self._plant.restore, state)
        self._out[2:] = array("d", numbers)

    def _fork(self) -> None:
        """Fork the process; the child continues with the sockets and the folder that the node sent."""
        refusal = 0 if len(os.listdir("/proc/self/task")) == 1 else errno.EBUSY  # a fork loses threads
        if (forked := fork_with_sockets(self._orders, self._frames, int(self._order[1]), refusal=refusal)) is None:
            return
        lead_session()
        child_fields, orders, frames = forked
        self._spec = self._spec | child_fields
        self._use(orders, frames, poll=self._spec["poll"])
        self._frames.sendall(PROCESS_ID.pack(os.getpid()))
        set_up_process(self._spec)
        reopen_files(self._spec["folder"])

    def _fail(self, text: str) -> NoReturn:
        """Send an error to the node and exit."""
        raw = text.encode(errors="backslashreplace")  # a text of the user's may have lone surrogates
        self._out[0], self._out[1] = FrameKind.FAILED, len(raw)
        try:
            self._frames.sendall(self._out)
            self._frames.sendall(raw)
        except OSError:
            leave(0)
        close(self._plant)
        os._exit(1)  # the node reads the log and removes the folder


def _print_lines() -> None:
    """Let each line that is printed appear at once: a buffer would be lost at the end, and doubled by a fork."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)


def serve(orders_descriptor: int, frames_descriptor: int, parent: int) -> NoReturn:
    """Read the specification from the socket and serve the node."""
    orders = socket.socket(fileno=orders_descriptor)
    spec = receive_spec(orders, parent)
    lead_session()
    _print_lines()
    PlantHost(orders, socket.socket(fileno=frames_descriptor), spec).run()


def print_description() -> NoReturn:
    """Print the description of the plant that standard input names, as JSON; the exit code is 1 after an error."""
    request = json.loads(sys.stdin.readline())
    die_with_parent(request["parent"])
    lead_session()
    reply = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the user's module prints is no description
    _print_lines()
    try:
        plant = create(request["plant"], request["arguments"], own_class=request["own_class"])
        try:
            text, code = json.dumps(dataclasses.asdict(describe(plant))), 0
        finally:
            close(plant)
    except ZenostatError as error:
        text, code = json.dumps(to_wire(error)), 1
    except BaseException as error:
        message = f"plant {request['plant']!r} cannot be created\n{users_traceback(error)}"
        text, code = json.dumps({"error": "PlantFailed", "message": message}), 1
    with reply:
        reply.write(text)
    os._exit(code)  # threads of the user's must not delay the end


if __name__ == "__main__":
    if sys.argv[1:] == ["describe"]:
        print_description()
    serve(*map(int, sys.argv[1:4]))
