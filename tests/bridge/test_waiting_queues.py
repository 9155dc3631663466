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
        self.queues = WaitingQueues(self.tasks.append, lambda text, sender: self.reports.append(f"{sender}: {text}"))
        self.queue = self.queues.add(keys.ACTUATOR)

    def receive(self, number: int, name: str = "valve", sender: str = "panel") -> None:
        key = keys.ACTUATOR.at("office", name=name, sender=sender)
        if self.queue.admit(1) or self.queue.give_way(1, key):
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
    assert f"panel: actuator/{{sender}}/{{name}}: {19 * MAX_PENDING} messages dropped (valve), " in thread.reports[0]


@given(st.lists(st.tuples(st.sampled_from(["panel", "op"]), st.sampled_from(list("abc"))), max_size=1200))
def test_waiting_queue__newest_message_of_each_key_stays(messages: list[tuple[str, str]]) -> None:
    thread = Thread()
    for number, (sender, name) in enumerate(messages):
        thread.receive(number, name, sender)
    thread.run(len(thread.tasks))
    newest = {key: number for number, key in enumerate(messages)}
    assert {*newest.values()} <= {*thread.handled}
    assert len(thread.handled) == min(len(messages), MAX_PENDING)


@given(st.lists(st.sampled_from(["valve", "pump"]), max_size=100))
def test_waiting_queue__flood_displaces_only_its_own_messages(names: list[str]) -> None:
    thread = Thread()
    for number in range(2 * MAX_PENDING):
        thread.receive(number, "fan", "flooder")
    for number, name in enumerate(names, 2 * MAX_PENDING):
        thread.receive(number, name)
        thread.receive(0, "fan", "flooder")
    thread.run(len(thread.tasks))
    assert [number for number in thread.handled if number >= 2 * MAX_PENDING] == [
        number for number, _ in enumerate(names, 2 * MAX_PENDING)
    ]
    assert [report.split(":")[0] for report in thread.reports] == ["flooder"]


def test_waiting_queue__report_has_the_names_of_the_first_points_and_counts_all() -> None:
    thread = Thread()
    for number in range(MAX_PENDING + 8):
        thread.receive(number, f"p{number}")
    thread.run(len(thread.tasks))
    assert thread.handled == [*range(MAX_PENDING)]
    assert "8 messages dropped (p256, p257, p258, p259, p260, …), " in thread.reports[0]


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
    assert len(thread.handled) + sum(int(text.split(": ")[2].split()[0]) for text in thread.reports) == number + 1
    assert thread.handled == sorted(thread.handled)
