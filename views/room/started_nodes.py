"""Nodes that operators start on the page from scenarios and recordings: programs that end with the control room."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zenostat.bridge.runtime.processes import ZENOSTAT, end_processes
from zenostat.topics.errors import NodeNotFound, RequestRejected, did_you_mean, from_wire
from zenostat.topics.keys import check_name
from zenostat.views.room.numbers import to_json
from zenostat.views.room.updates import Updates

TOPIC = "started"
MODULE = "zenostat.eplus_node"
REPLAY_MODULE = "zenostat.eplus_node.replay_program"

MAX_RUNNING = 8
"""Largest number of nodes that run at a time."""

_KEPT = 24
_END_S = 10.0
_RUNNING = ("starting", "running")


@dataclass(eq=False)
class StartedNode:
    """A node that was started from the page.

    Attributes:
        name: its name on the bus.
        scenario: name of its scenario, its training or its recording.
        operator: who has started it.
        process: its program; set when it is started.
        controller: folder of a training or file of a controller, which controls it; empty for none.
        state: `starting`, `running`, `ended` or `failed`.
        text: why it failed.
    """

    name: str
    scenario: str
    operator: str
    process: subprocess.Popen[bytes] = field(init=False)
    controller: str = ""
    state: str = "starting"
    text: str = ""


class StartedNodes:
    """The nodes that were started from the page.

    Args:
        settings: of each node: the bus that it joins, and its keys.
        updates: receives the list after each change.
    """

    def __init__(self, settings: Mapping[str, Any], updates: Updates) -> None:
        self._settings, self._updates = {**settings, "listen": []}, updates
        self._nodes: list[StartedNode] = []
        self._threads: list[threading.Thread] = []
        self._lock, self._is_closed = threading.Lock(), False
        self._publish()

    def start(
        self,
        file: Path,
        name: str,
        operator: str,
        settings: Mapping[str, Any],
        *,
        controller: str = "",
        title: str = "",
    ) -> None:
        """Start a node; its state follows in the updates.

        Args:
            file: its scenario.
            name: its name on the bus.
            operator: who starts it.
            settings: mode and speed.
            controller: as `zenostat run --controller`, which is started with it; empty for none.
            title: shown in place of the scenario's name.

        Raises:
            InvalidConfig: an invalid name.
            RequestRejected: a node of that name runs, or too many nodes run.
        """
        fields = {**settings, "scenario": str(file), "monitoring": True}
        self._launch(MODULE, fields, StartedNode(name, title or file.stem, operator, controller=controller))

    def replay(self, file: Path, name: str, operator: str, speed: float, *, title: str) -> None:
        """Replay a recording as a node, which ends with the recording; its state follows in the updates.

        Args:
            file: the recording.
            name: of the node on the bus.
            operator: who starts it.
            speed: simulated seconds per second.
            title: shown in place of a scenario's name.

        Raises:
            InvalidConfig: an invalid name.
            RequestRejected: a node of that name runs, or too many nodes run.
        """
        self._launch(REPLAY_MODULE, {"file": str(file), "speed": speed}, StartedNode(name, title, operator))

    def _launch(self, module: str, fields: Mapping[str, Any], node: StartedNode) -> None:
        check_name(node.name, "the node's name")
        with self._lock:
            running = [each for each in self._nodes if each.state in _RUNNING]
            if self._is_closed or len(running) >= MAX_RUNNING:
                raise RequestRejected(f"{MAX_RUNNING} nodes that were started from the page run; end one of them first")
            if node.name in (each.name for each in running):
                raise RequestRejected(f"a node {node.name!r} was started from the page already")
            # A process group of its own: Ctrl-C in the terminal is for the server, whose end ends the node's input.
            node.process = subprocess.Popen(
                [sys.executable, "-P", "-m", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, process_group=0
            )
            self._nodes = [*[each for each in self._nodes if each.name != node.name], node][-_KEPT:]
            arguments = (node, {**self._settings, **fields, "name": node.name})
            thread = threading.Thread(target=self._follow, args=arguments, name=f"started-{node.name}", daemon=True)
            self._threads = [*[each for each in self._threads if each.is_alive()], thread]
            thread.start()
        self._publish()

    def stop(self, name: str) -> None:
        """End a node that was started from the page, without waiting for it.

        Raises:
            NodeNotFound: no such node runs.
        """
        with self._lock:
            running = {node.name: node for node in self._nodes if node.state in _RUNNING}
        if name not in running:
            raise NodeNotFound(f"no node {name!r} that was started from the page runs; {did_you_mean(name, running)}")
        running[name].process.terminate()

    def content(self) -> list[dict[str, str]]:
        """Return all nodes for the page, the latest one last."""
        with self._lock:
            return [
                {name: getattr(node, name) for name in ("name", "scenario", "operator", "state", "text")}
                for node in self._nodes
            ]

    def close(self) -> None:
        """End all nodes, and wait for their ends."""
        with self._lock:
            self._is_closed = True
            nodes, threads = [*self._nodes], [*self._threads]
        end_processes([node.process for node in nodes], _END_S)
        for thread in threads:
            thread.join(_END_S)

    # In a thread for each node

    def _follow(self, node: StartedNode, fields: dict[str, Any]) -> None:
        """Give a node its settings, and follow it to its end."""
        process = node.process
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError):  # it has ended already, which its output shows
            process.stdin.write(json.dumps(fields, default=str).encode() + b"\n")
            process.stdin.flush()
        line = process.stdout.readline()
        reply = json.loads(line) if line else {}
        if "ready" in reply:
            self._set(node, "running")
            controller = self._control(node)
            last = process.stdout.read().splitlines()[-1:]  # until its end
            reply = json.loads(last[0]) if last else {}
            code = process.wait()
            if controller is not None:
                controller.terminate()
                controller.wait()
            text = str(from_wire(reply)) if "error" in reply else f"it ended with code {code}"
            self._set(node, *(("ended", "") if code == 0 else ("failed", text)))
        else:
            code = process.wait()
            stopped = code in (0, -signal.SIGTERM) and "error" not in reply
            text = str(from_wire(reply)) if "error" in reply else "" if stopped else f"it ended with code {code}"
            self._set(node, "ended" if stopped else "failed", text)
        process.stdout.close()
        with suppress(OSError):
            process.stdin.close()

    def _control(self, node: StartedNode) -> subprocess.Popen[bytes] | None:
        """Start the controller of a node; it ends with the node."""
        if not node.controller:
            return None
        keys = self._settings.get("keys")
        options = ["--connect", self._settings["connect"][0], *(["--keys", str(keys)] if keys else [])]
        controller = subprocess.Popen(
            [*ZENOSTAT, "run", "--node", node.name, "--controller", node.controller, *options],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, process_group=0,
        )  # fmt: skip
        threading.Thread(target=self._watch_controller, args=(node, controller), daemon=True).start()
        return controller

    def _watch_controller(self, node: StartedNode, controller: subprocess.Popen[bytes]) -> None:
        """Show that a controller has failed while its node goes on."""
        code = controller.wait()
        if code not in (0, -signal.SIGTERM) and node.process.poll() is None:
            text = (
                f"its controller ended with code {code}, so its baseline control is in effect; the log has the reason"
            )
            self._set(node, "running", text)

    def _set(self, node: StartedNode, state: str, text: str = "") -> None:
        with self._lock:
            node.state, node.text = state, text
        self._publish()

    def _publish(self) -> None:
        self._updates.publish(TOPIC, to_json({"nodes": self.content()}))
