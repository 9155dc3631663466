"""The log of a recording: its entries are in the order in which the node handled the messages."""

import msgpack

from zenostat.bridge.recording.reader import RecordedItem
from zenostat.metrics.recording.log import LogBuilder
from zenostat.topics.messages import (
    AlarmChange,
    AlarmPriority,
    AlarmState,
    AlarmTransition,
    Event,
    EventKind,
    EventState,
    NotifyType,
)

HOUR_NS = 3_600_000_000_000


def write(value: float, time_ns: int) -> RecordedItem:
    return RecordedItem("actuator/panel/valve", "ActuatorWrite", time_ns, msgpack.packb({"value": value}))


def command(step: int, time_ns: int) -> RecordedItem:
    return RecordedItem("command/mpc", "Command", time_ns, msgpack.packb({"episode": 1, "step": step}))


def test_log__clock_that_is_set_back_does_not_change_the_order() -> None:
    log = LogBuilder()
    for value, hours in ((6.0, 5), (7.0, 2), (8.0, 3)):
        log.add(write(value, hours * HOUR_NS), "")
    assert [entry.subject for entry in log.finish()] == [f"valve = {value} at priority 8" for value in (6.0, 7.0, 8.0)]


def test_log__command_that_is_rejected_precedes_what_came_between_it_and_its_result() -> None:
    change = AlarmChange(
        alarm="warm", point="level", slot=0, transition=AlarmTransition.TO_OFFNORMAL, event_state=EventState.HIGH_LIMIT,
        state=AlarmState.ACTIVE, priority=AlarmPriority.HIGH, notify=NotifyType.ALARM, unit="m",
        time="2026-01-01T00:00:00",
    )  # fmt: skip
    log = LogBuilder()
    log.add(command(0, 1), "")
    log.add(write(6.0, 2), "")
    log.add(command(1, 3), "")
    log.add_event(Event(kind=EventKind.ALARM, text="too warm", alarm=change), 4)
    log.add_event(Event(kind=EventKind.REJECTED, text="too late", source="mpc"), 5)
    entries = [(entry.kind, entry.count, entry.result) for entry in log.finish()]
    assert entries[:3] == [("command", 1, "accepted"), ("write", 1, "accepted"), ("command", 1, "rejected: too late")]
    assert [kind for kind, _, _ in entries[3:]] == ["alarm"]
