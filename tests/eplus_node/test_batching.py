"""What a node streams, gathered: on a clock that goes only when it is told to."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from eplus_node.batching import BATCH_S, SampleBatcher
from topics import codec
from topics.messages import Batch


class Bench:
    """Batches whose timer and publisher are at hand."""

    def __init__(self) -> None:
        self.now_s = 10.0
        self.calls: list[tuple[float, Callable[[], None]]] = []
        self.sent: list[list[tuple[str, bytes]]] = []
        publisher: Any = SimpleNamespace(put=self.put, declare_matching_listener=lambda _: None)
        timer: Any = SimpleNamespace(clock=lambda: self.now_s, at=lambda due_s, call: self.calls.append((due_s, call)))
        self.batches = SampleBatcher(publisher, timer)

    def put(self, payload: bytes) -> None:
        self.sent.append([(sent.topic, sent.payload) for sent in codec.decode(Batch, payload).messages])

    def ring(self) -> None:
        """The timer does what is due."""
        calls, self.calls = self.calls, []
        for _, call in calls:
            call()


def test_what_comes_within_a_tenth_of_a_second_goes_in_one_batch_in_its_order():
    bench = Bench()
    said = [("event", b"a"), ("sample", b"b"), ("sample", b"b"), ("manifest", b"")]
    for topic, payload in said:
        bench.batches.add(topic, payload)
        bench.now_s += BATCH_S / 5
    assert bench.sent == []
    assert [due_s for due_s, _ in bench.calls] == [10.0 + BATCH_S]
    bench.ring()
    assert bench.sent == [said]
    assert bench.calls == []


def test_the_next_batch_is_due_a_tenth_of_a_second_after_its_own_first_message():
    bench = Bench()
    bench.batches.add("sample", b"1")
    bench.ring()
    bench.now_s = 20.0
    bench.batches.add("sample", b"2")
    assert [due_s for due_s, _ in bench.calls] == [20.0 + BATCH_S]
    bench.ring()
    assert bench.sent == [[("sample", b"1")], [("sample", b"2")]]


def test_what_is_large_goes_in_several_batches_and_nothing_is_lost():
    bench, payloads = Bench(), [bytes([number]) * 400_000 for number in range(10)]
    for payload in payloads:
        bench.batches.add("sample", payload)
    bench.ring()
    assert [payload for batch in bench.sent for _, payload in batch] == payloads
    assert len(bench.sent) > 1
    assert all(sum(len(payload) for _, payload in batch[:-1]) < 1 << 20 for batch in bench.sent)


def test_the_rest_goes_at_the_end_and_nothing_after_it():
    bench = Bench()
    bench.batches.add("event", b"stopped")
    bench.batches.close()
    assert bench.sent == [[("event", b"stopped")]]
    bench.ring()
    bench.batches.add("event", b"late")
    bench.ring()
    assert bench.sent == [[("event", b"stopped")]]


def test_it_is_wanted_while_somebody_listens():
    bench = Bench()
    assert not bench.batches.has_listeners
    for matching in (True, False):
        bench.batches._on_listeners(SimpleNamespace(matching=matching))  # type: ignore[arg-type]
        assert bench.batches.has_listeners is matching
