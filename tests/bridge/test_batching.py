"""Batches of published messages, on a simulated clock."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from zenostat.bridge.node.batching import BATCH_S, SampleBatcher
from zenostat.topics import codec
from zenostat.topics.messages import Batch


class Setup:
    """A batcher with a simulated timer and publisher."""

    def __init__(self) -> None:
        self.now_s = 10.0
        self.calls: list[tuple[float, Callable[[], None]]] = []
        self.sent: list[list[tuple[str, bytes]]] = []
        publisher: Any = SimpleNamespace(put=self.put, declare_matching_listener=lambda _: None)
        timer: Any = SimpleNamespace(clock=lambda: self.now_s, at=lambda due_s, call: self.calls.append((due_s, call)))
        self.batches = SampleBatcher(publisher, timer)

    def put(self, payload: bytes) -> None:
        self.sent.append([(sent.topic, sent.payload) for sent in codec.decode(Batch, payload).messages])

    def run_timer(self) -> None:
        """Run the scheduled calls."""
        calls, self.calls = self.calls, []
        for _, call in calls:
            call()


def test_batcher__sends_messages_within_a_batch_interval_in_one_batch_in_order():
    setup = Setup()
    messages = [("event", b"a"), ("sample", b"b"), ("sample", b"b"), ("manifest", b"")]
    for topic, payload in messages:
        setup.batches.add(topic, payload)
        setup.now_s += BATCH_S / 5
    assert setup.sent == []
    assert [due_s for due_s, _ in setup.calls] == [10.0 + BATCH_S]
    setup.run_timer()
    assert setup.sent == [messages]
    assert setup.calls == []


def test_batcher__schedules_each_batch_from_its_first_message():
    setup = Setup()
    setup.batches.add("sample", b"1")
    setup.run_timer()
    setup.now_s = 20.0
    setup.batches.add("sample", b"2")
    assert [due_s for due_s, _ in setup.calls] == [20.0 + BATCH_S]
    setup.run_timer()
    assert setup.sent == [[("sample", b"1")], [("sample", b"2")]]


def test_batcher__splits_large_batches_without_loss():
    setup, payloads = Setup(), [bytes([number]) * 400_000 for number in range(10)]
    for payload in payloads:
        setup.batches.add("sample", payload)
    setup.run_timer()
    assert [payload for batch in setup.sent for _, payload in batch] == payloads
    assert len(setup.sent) > 1
    assert all(sum(len(payload) for _, payload in batch[:-1]) < 1 << 20 for batch in setup.sent)


def test_close__sends_pending_messages_and_nothing_afterwards():
    setup = Setup()
    setup.batches.add("event", b"stopped")
    setup.batches.close()
    assert setup.sent == [[("event", b"stopped")]]
    setup.run_timer()
    setup.batches.add("event", b"late")
    setup.run_timer()
    assert setup.sent == [[("event", b"stopped")]]


def test_has_listeners__follows_the_matching_status():
    setup = Setup()
    assert not setup.batches.has_listeners
    for matching in (True, False):
        setup.batches._on_listeners(SimpleNamespace(matching=matching))  # type: ignore[arg-type]
        assert setup.batches.has_listeners is matching
