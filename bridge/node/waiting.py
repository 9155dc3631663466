"""Messages and requests that wait for a server's thread: how many may, and which give way to newer ones."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

from zenostat.topics import keys
from zenostat.topics.plurals import counted

MAX_PENDING = 256
"""Messages or requests of a topic that may wait. A further message replaces the oldest with the key of which most wait,
and is dropped if each has a key of its own; a further request is rejected."""

LARGE_BYTES = 1 << 16
"""Size from which a message or request is large."""

MAX_LARGE = 8
"""Large messages and requests of all topics that may wait: 256 of each topic would fill the memory."""

MAX_NAMES = 5
"""Names in the report of messages dropped; it counts those of further ones as `OTHERS`."""

OTHERS = "…"

Task = Callable[[], None]


class _Entry(NamedTuple):
    """A task that waits; a message that arrives may replace it."""

    task: Task
    key: str
    is_large: bool


class WaitingQueues:
    """The queues of a node, one for each topic.

    Args:
        post: runs a task in the server's thread.
        on_dropped: called in that thread with a text, and the sender whose messages were dropped.

    Attributes:
        rate_limited: number of messages dropped and requests rejected because too many were waiting.
    """

    def __init__(self, post: Callable[[Task], None], on_dropped: Callable[[str, str], None]) -> None:
        self.post, self._on_dropped = post, on_dropped
        self.rate_limited = 0
        self.lock = threading.Lock()
        self.large = threading.BoundedSemaphore(MAX_LARGE)
        self._queues: list[WaitingQueue] = []
        self._dropped: dict[tuple[keys.Topic, str], Counter[str]] = {}

    def add(self, topic: keys.Topic) -> WaitingQueue:
        """Return a new queue for a topic."""
        queue = WaitingQueue(topic, self)
        self._queues.append(queue)
        return queue

    def run_all(self) -> None:
        """Run all tasks that wait; for the server's thread."""
        for queue in self._queues:
            queue.run_all()

    def clear(self) -> None:
        """Forget all tasks."""
        for queue in self._queues:
            queue.clear()

    def count_dropped(self, topic: keys.Topic, sender: str, name: str) -> bool:
        """Count a dropped message under the lock; return whether `report_dropped` is to be posted.

        It counts for up to 256 senders at a time, since strangers may have any number of names.
        """
        is_new = (topic, sender) not in self._dropped
        if is_new and len(self._dropped) == MAX_PENDING:
            return False
        names = self._dropped.setdefault((topic, sender), Counter())
        names[name if name in names or len(names) < MAX_NAMES else OTHERS] += 1
        return is_new

    def report_dropped(self, topic: keys.Topic, sender: str) -> None:
        """Report the dropped messages of a sender; for the server's thread."""
        with self.lock:
            names = self._dropped.pop((topic, sender))
        self._on_dropped(
            f"{topic.key}: {counted(names.total(), 'message')} dropped ({', '.join(names)}), older ones before newer "
            f"ones of the same key, since {MAX_PENDING} were waiting",
            sender,
        )


class WaitingQueue:
    """The messages or requests of one topic that wait.

    Each task that is appended has a turn in the server's thread, in which the first one of the queue runs. If one has
    run or given way before its turn, a later one uses that turn.

    Args:
        topic: of the messages or requests.
        queues: of the node.
    """

    def __init__(self, topic: keys.Topic, queues: WaitingQueues) -> None:
        self._topic, self._queues = topic, queues
        self._entries: deque[_Entry] = deque()
        self._counts: Counter[str] = Counter()  # of the entries, by key
        self._turns = 0

    def admit(self, size: int) -> bool:
        """Return whether a message or request of some bytes may wait, and count it if it is large."""
        if len(self._entries) < MAX_PENDING and (size < LARGE_BYTES or self._queues.large.acquire(blocking=False)):
            return True
        self._queues.rate_limited += 1
        return False

    def append(self, size: int, task: Task, key: str = "") -> None:
        """Let a task wait that has been admitted, or for which another one has given way."""
        with self._queues.lock:
            self._entries.append(_Entry(task, key, size >= LARGE_BYTES))
            self._counts[key] += 1
            has_turn = self._turns >= len(self._entries)
            self._turns += not has_turn
        if not has_turn:
            self._queues.post(self._take_turn)

    def give_way(self, size: int, key: str) -> bool:
        """Drop a message, so that a flood of one key displaces only its own.

        It is the oldest with the key of which most wait, the new one included; or the new one itself, if that is large
        or each has a key of its own.

        Returns:
            Whether the new one may wait.
        """
        with self._queues.lock:
            is_crowded = key in self._counts or len(self._counts) < len(self._entries)
            may_wait, dropped = is_crowded and size < LARGE_BYTES, key
            if may_wait:
                dropped = max(self._counts, key=lambda each: self._counts[each] + (each == key))
                oldest = next(entry for entry in self._entries if entry.key == dropped)
                self._entries.remove(oldest)
                self._release(oldest)
            sender, name = map(keys.shortened, self._topic.names_in(dropped))
            is_first = self._queues.count_dropped(self._topic, sender, name)
        if is_first:
            self._queues.post(lambda: self._queues.report_dropped(self._topic, sender))
        return may_wait

    def run_all(self) -> None:
        """Run all tasks that wait, before their turns."""
        for _ in range(len(self._entries)):
            self._run_next()

    def clear(self) -> None:
        """Forget all tasks."""
        with self._queues.lock:
            self._entries.clear()
            self._counts.clear()

    def _take_turn(self) -> None:
        with self._queues.lock:
            self._turns -= 1
        self._run_next()

    def _run_next(self) -> None:
        with self._queues.lock:
            entry = self._entries.popleft() if self._entries else None
            if entry is not None:
                self._release(entry)
        if entry is not None:
            entry.task()

    def _release(self, entry: _Entry) -> None:
        """Count an entry no more; under the lock."""
        if self._counts[entry.key] == 1:
            del self._counts[entry.key]
        else:
            self._counts[entry.key] -= 1
        if entry.is_large:
            self._queues.large.release()
