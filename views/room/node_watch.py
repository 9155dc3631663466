"""One node, followed by one thread for all open pages."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

from zenostat.bridge.client.bus import Bus
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import NodeLost, NodeNotFound, RequestRejected, ZenostatError
from zenostat.topics.messages import Event, EventKind, Mode, State
from zenostat.topics.points import value_index
from zenostat.views.room.description import NodeDescription, describe
from zenostat.views.room.numbers import to_json
from zenostat.views.room.state import node_state, summary
from zenostat.views.room.step_rate import StepRate
from zenostat.views.room.updates import Updates

T = TypeVar("T")

POLL_S = 0.5
"""Time between two polls of a node, whatever the number of pages."""

_ABSENT_POLL_S, _LONGEST_ABSENT_POLL_S = 2.0, 60.0
"""Time between polls of an absent node, doubled by each; its liveliness token shows its return at once."""
_PAUSE_S = 0.1
_END_STATES = (State.ENDED, State.FAILED, State.STOPPED)
_EVENTS = 500
_EVENTS_SENT = 40


class NodeWatch:
    """A node that is or was on the bus. Its thread polls the node; attributes are replaced, not changed.

    Args:
        bus: connection to the bus.
        node: the node's name.
        updates: receives the state (`node:NAME`) and the latest events (`events:NAME`).
        on_change: called after each poll, in the thread.

    Attributes:
        node: its name.
        description: of its latest instance; None before the first poll.
        state: its latest state; None while it is not reachable.
        problem: why it is not reachable; empty while it is.
        has_ended: whether it was stopped, or is a replay that has ended.
        polls: number of polls.
        summary: its entry in the list of nodes, of the latest poll; None before the first one.
    """

    def __init__(self, bus: Bus, node: str, updates: Updates, on_change: Callable[[], None]) -> None:
        self.node = node
        self.description: NodeDescription | None = None
        self.state: dict[str, Any] | None = None
        self.problem = "not polled yet"
        self.has_ended = self._is_stopped = False
        self.polls = 0
        self.summary: dict[str, Any] | None = None
        self._bus, self._updates, self._on_change = bus, updates, on_change
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._event_number = self._sent_number = 0
        self._step_rate = StepRate()
        self._wake, self._is_closed, self._is_stale = threading.Event(), False, True
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name=f"room-{node}", daemon=True)
        self._thread.start()

    def refresh(self, *, restarted: bool = False) -> None:
        """Poll at once, because something has changed; with `restarted`, the node may be another instance."""
        self._is_stale = self._is_stale or restarted
        self._wake.set()

    def close(self) -> None:
        """End the thread, after the poll that is running; nothing is published any more."""
        with self._lock:
            self._is_closed = True
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread."""
        self._thread.join(timeout_s)

    @property
    def topics(self) -> tuple[str, str]:
        """The topics of its state and of its latest events."""
        return f"node:{self.node}", f"events:{self.node}"

    @property
    def is_absent(self) -> bool:
        """Whether its latest poll has failed."""
        return self.state is None and self.polls > 0

    @property
    def is_branch(self) -> bool:
        """Whether it is a branch of another node."""
        return self.description is not None and bool(self.description.manifest.branch_of)

    def events(self) -> list[dict[str, Any]]:
        """Return the latest events, the newest one last."""
        with self._lock:
            return [*self._events]

    def add_event(self, event: Event) -> None:
        """Keep an event and have it sent; from any thread. `BadMessage` if its step has no simulated time."""
        with self._lock:
            entry = event.model_dump(mode="json", exclude={"alarm"}) | {"time": self._time(event.step)}
            self._event_number += 1
            entry["number"] = self._event_number
            self._events.append(entry)
            self._is_stopped = event.kind is EventKind.STOPPED
        self._wake.set()

    def _time(self, step: int) -> str:
        """Return the simulated time of a step; empty before the first poll."""
        if self.description is None:
            return ""
        return self.description.manifest.time_at(step).isoformat()

    # In the thread

    def _run(self) -> None:
        wait_s = POLL_S
        while not self._is_closed:
            self._wake.clear()
            self._poll()
            if self.description is not None:
                entry = summary(self.description, self.state, self._rate(), self.problem)
                self.summary = entry | {"has_ended": self.has_ended}
            self.polls += 1
            if self._is_closed:
                return
            self._publish()
            absent_s = min(max(2.0 * wait_s, _ABSENT_POLL_S), _LONGEST_ABSENT_POLL_S)
            wait_s = absent_s if self.problem else POLL_S
            if self._wake.wait(wait_s) and not self._is_closed:
                time.sleep(_PAUSE_S)  # however often something changes

    def _poll(self) -> None:
        try:
            if self._is_stale or self.description is None or self.state is None:
                self._is_stale = False
                self._describe()
            assert self.description is not None
            manifest, status = self.description.manifest, self._bus.status(self.node)
            try:
                latest = self._bus.latest(self.node)
                sample = SampleView(latest, manifest, value_index(manifest))
            except RequestRejected:  # there is none yet
                sample = None
            # The replay of a recording takes no requests.
            alarms = _unless(RequestRejected, self._bus.alarms, self.node)
            faults = _unless(RequestRejected, self._bus.fault_plan, self.node)
            self.state = node_state(self.description, status, sample, alarms, faults)
            self.problem, self.has_ended = "", False
            is_stopped = status.state in _END_STATES or (status.paused and not status.steps_left)
            pace_s = manifest.step_s / status.speed if status.mode is Mode.PACED else 0.0
            episode, step = status.episode[0], status.step[0]
            self._step_rate.add(time.monotonic(), episode, step, is_stopped=is_stopped, pace_s=pace_s)
        except (NodeLost, NodeNotFound):
            is_replay = self.description is not None and self.description.manifest.replay
            self.has_ended = self.has_ended or self._is_stopped or is_replay
            self._lose("it has ended" if self.has_ended else "it left the bus")
        except ZenostatError as error:
            self._lose(str(error))
        except Exception as error:  # a message of a stranger must not end the thread
            self._lose(f"{type(error).__name__}: {error}")

    def _lose(self, problem: str) -> None:
        self.state, self.problem = None, problem
        self._step_rate.clear()

    def _describe(self) -> None:
        manifest = self._bus.manifest(self.node)
        if self.description is None or self.description.manifest != manifest:
            source = manifest.branch_of or manifest.node
            geometry = _unless(ZenostatError, self._bus.geometry, source)  # some plants have none, or no systems
            self.description = describe(manifest, geometry, _unless(ZenostatError, self._bus.systems, source))

    def _publish(self) -> None:
        gone = {"node": self.node, "online": False, "problem": self.problem, "has_ended": self.has_ended}
        state = self.state or gone
        content, (state_topic, events_topic) = to_json(state), self.topics
        with self._lock:
            if self._is_closed:
                return
            self._updates.publish(state_topic, content)
            if self._event_number != self._sent_number:
                self._sent_number, latest = self._event_number, [*self._events][-_EVENTS_SENT:]
                self._updates.publish(events_topic, to_json({"node": self.node, "events": latest}))
        self._on_change()

    def _rate(self) -> float | None:
        """Return the simulated seconds per second; None if it is not known."""
        description = self.description
        return None if description is None else self._step_rate.rate(time.monotonic(), description.manifest.step_s)


def _unless(refusal: type[ZenostatError], ask: Callable[[str], T], node: str) -> T | None:
    """Return the answer of a node; None if it refuses with an error of this class."""
    try:
        return ask(node)
    except refusal:
        return None
