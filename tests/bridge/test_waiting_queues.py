"""Rules of waiting messages: each that stays has a turn, and a flood adds no more turns than messages may wait."""

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from zenostat.bridge.node.waiting import MAX_PENDING, WaitingQueues
from zenostat.topics import keys


class Thread:
    """A server's thread that runs its tasks when it is told to, and the messages that it has handled."""

    def __init__(self) -> None:
        self.tasks: list[Callable[[], None]] = []
        self.handled: list[int] = []
        self.reports: list[str] = []
        self.queues = WaitingQueues(self.tasks.append, lambda text, _sender: self.reports.append(text))
        self.queue = self.queues.add(keys.ACTUATOR)

    def receive(self, number: int, key: str = "valve") -> None:
        if self.queue.admit(1) or self.queue.give_way("panel", 1, key):
            self.queue.append(1, lambda: self.handled.append(number), key)

    def run(self, count: int) -> None:
        for _ in range(min(count, len(self.tasks))):
            self.tasks.pop(0)()


def test_waiting_queue__flood_adds_as_many_turns_as_messages_may_wait() -> None:
    thread = Thread()
    for number in range(20 * MAX_PENDING):
        thread.receive(number)
    assert len(thread.tasks) == MAX_PENDING + 1  # and the report
    thread.run(len(thread.tasks))
    assert thread.handled == [*range(19 * MAX_PENDING, 20 * MAX_PENDING)]
    assert len(thread.reports) == 1
    assert f"{19 * MAX_PENDING} messages dropped" in thread.reports[0]


@given(st.lists(st.tuples(st.sampled_from(["receive", "run", "before a command"]), st.integers(1, 300)), max_size=20))
def test_waiting_queue__no_message_that_stays_is_left_without_a_turn(changes: list[tuple[str, int]]) -> None:
    thread, number = Thread(), 0
    for change, count in changes:
        if change == "receive":
            for each in range(number, number + count):
                thread.receive(each)
            number += count
        elif change == "run":
            thread.run(count)
        else:
            thread.queue.run_all()
    thread.run(len(thread.tasks) + 1)
    assert thread.tasks == []
    thread.receive(number)
    thread.run(1)
    assert thread.handled[-1] == number
    assert len(thread.handled) + sum(int(text.split(": ")[1].split()[0]) for text in thread.reports) == number + 1
    assert thread.handled == sorted(thread.handled)
