"""A controller, as a program: each of its commands is a function of the sample that it answers and of nothing else.

`python -m chaos.controller SETTINGS`, JSON: endpoint, node, name, level, actuators (None: all), journal. It ends with 4
when the node is gone, or takes it for gone. SIGUSR1 has it repeat one command 300 times.
"""

import json
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any
from zlib import crc32

import numpy as np

import zenostat
from chaos.journal import Journal
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics.errors import EpisodeChanged, NodeLost, NodeNotFound, RequestRejected, SimulatorError
from zenostat.topics.messages import Actuator, CommandOp

LOST = 4
REPEATS = 300

# Numbers: NumPy looks for methods on a member of an enum, which runs Python, and drops what a signal raises there.
_KEEP, _SET, _RELEASE = int(CommandOp.KEEP), int(CommandOp.SET), int(CommandOp.RELINQUISH)
_repeat = False


def draw(sample: bytes, name: str) -> int:
    """A number, 0 to 2**32 - 1, that the sample's bytes and a name decide."""
    return crc32(name.encode(), crc32(sample))


def decide(sample: bytes, actuator: Actuator, *, whole: bool) -> tuple[int, float]:
    """Draw an operation on an actuator, and its value; a controller of the whole building sets all."""
    drawn = draw(sample, actuator.name)
    low, high = actuator.low or 0.0, actuator.high or 1.0
    if not whole and drawn % 16 == 0:
        return _RELEASE, low
    if not whole and drawn % 16 < 3:
        return _KEEP, low
    return _SET, low + (high - low) * (drawn / 2**32)


class Controller:
    """Answers every sample that it sees."""

    def __init__(self, bus: Bus, settings: dict[str, Any]) -> None:
        self._bus, self._settings = bus, settings
        self._journal = Journal(Path(settings["journal"]))

    def run(self) -> None:
        """Until the node is gone; an episode that failed is followed by a new link."""
        while True:
            try:
                with self._link() as link:
                    self._follow(link)
            except SimulatorError:
                continue

    def _link(self) -> ControllerLink:
        settings = self._settings
        names, priority = settings["actuators"], settings["priority"]
        while True:
            try:
                return self._bus.controller(settings["node"], name=settings["name"], priority=priority, actuators=names)
            except RequestRejected:  # the one before is still there, for all that the node knows
                threading.Event().wait(0.05)

    def _follow(self, link: ControllerLink) -> None:
        sample = self._present(link)
        while True:
            if not sample.truncated:
                self._answer(link, sample)
            sample = self._next(link)

    def _present(self, link: ControllerLink) -> SampleView:
        return link.set_current(self._bus.latest(self._settings["node"]))

    def _next(self, link: ControllerLink) -> SampleView:
        while True:
            try:
                return link.receive()
            except EpisodeChanged:
                return self._present(link)
            except RequestRejected:
                continue  # what was refused came in this one's name, or too late; the next sample tells

    def _answer(self, link: ControllerLink, sample: SampleView) -> None:
        global _repeat
        whole, names = self._settings["actuators"] is None, self._settings["actuators"]
        mask, values = np.zeros(len(link.manifest.actuators), np.uint8), np.zeros(len(link.manifest.actuators))
        for index, actuator in enumerate(link.manifest.actuators):
            if whole or actuator.name in names:
                mask[index], values[index] = decide(sample.message.values, actuator, whole=whole)
        times = 2 if draw(sample.message.values, "twice") % 50 == 0 else 1
        if _repeat:
            times, _repeat = REPEATS, False
        done = [(i, float(values[i]) if mask[i] == _SET else None) for i in np.flatnonzero(mask).tolist()]
        self._journal.note(name=link.name, episode=sample.episode, step=sample.step, times=times, values=done)
        for _ in range(times):
            link.send(values, None if whole else mask.tobytes())


def _on_repeat(_number: int, _frame: FrameType | None) -> None:
    global _repeat
    _repeat = True


def main() -> int:
    """Controls until the node is gone."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.signal(signal.SIGUSR1, _on_repeat)
    settings = json.loads(sys.argv[1])
    try:
        with zenostat.connect(settings["endpoint"], affinity=Affinity.OFF) as bus:
            Controller(bus, settings).run()
    except (NodeLost, NodeNotFound) as error:
        sys.stderr.write(f"{error}\n")
        return LOST
    finally:
        signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # else Python restores the default as it ends, which kills
    return 0


if __name__ == "__main__":
    sys.exit(main())
