"""The hash chain of a recording's audit log, by entries and records without a file."""

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from zenostat.bridge.recording.audit_chain import AuditChain, AuditResult, check_audit, digest
from zenostat.bridge.recording.reader import RecordedItem, RecordingEnd
from zenostat.topics import codec, recording
from zenostat.topics.recording import RecordedAudit

WRITES, SAMPLES = 1, 2
ABOUT = {recording.AUDIT: "sha256", "zenostat": "1.0"}
ATTACHMENTS = {"manifest.json": b"{}", "scenario.yaml": b"id: a"}


def _recorded(chunks: int = 3, entries: int = 4) -> tuple[list[RecordedItem], dict[str, str]]:
    """Items of a recording with some entries in each chunk, samples between them, and its summary."""
    chain, items, time_ns = AuditChain(), list[RecordedItem](), 0
    chain.begin(ABOUT, ATTACHMENTS)
    chain.add_channel(WRITES, "actuator/panel/a", "Write")
    chain.add_channel(SAMPLES, "sample", "Sample")
    for chunk in range(chunks):
        for number in range(entries):
            for channel, topic, schema in ((SAMPLES, "sample", "Sample"), (WRITES, "actuator/panel/a", "Write")):
                time_ns += 1
                payload = f"{chunk} {number}".encode()
                chain.add(channel, time_ns, payload)
                items.append(RecordedItem(topic, schema, time_ns, payload))
        record = chain.seal()
        assert record is not None
        items.append(RecordedItem("audit", RecordedAudit.__name__, time_ns, codec.encode(record)))
    return items, chain.summary()


def _check(
    items: list[RecordedItem],
    summary: dict[str, str],
    *,
    has_chain: bool = True,
    about: dict[str, str] = ABOUT,
    attachments: dict[str, bytes] = ATTACHMENTS,
) -> AuditResult:
    reader = SimpleNamespace(
        about=about if has_chain else {},
        versions=about,
        attachments=attachments,
        messages=lambda: iter(items),
        end=RecordingEnd(is_complete=bool(summary), metadata=summary),
    )
    return check_audit(reader)  # type: ignore[arg-type]


def _entries(items: list[RecordedItem]) -> list[int]:
    return [place for place, item in enumerate(items) if item.schema == "Write"]


def test_audit_chain__is_unbroken_as_it_was_recorded() -> None:
    items, summary = _recorded()
    result = _check(items, summary)
    assert (result.problems, result.entries, result.head) == ([], 12, summary["audit_head"])
    assert str(result) == f"audit log: unbroken, 12 entries, head {summary['audit_head']}"


def test_audit_chain__head_depends_on_each_entry() -> None:
    one, other = AuditChain(), AuditChain()
    for chain, payload in ((one, b"26.5"), (other, b"26.6")):
        chain.add_channel(WRITES, "actuator/panel/a", "Write")
        chain.add(WRITES, 1, payload)
        chain.seal()
        chain.add(WRITES, 2, b"same")
        chain.seal()
    assert one.head != other.head
    assert digest(b"a", 1, b"b") != digest(b"a\0", 1, b"b") != digest(b"a", 2, b"b")


def test_audit_chain__cut_off_recording_is_unbroken_up_to_its_end() -> None:
    items, _ = _recorded()
    last_chunk = items.index(next(item for item in items if item.schema == "RecordedAudit")) + 1
    assert _check(items[:last_chunk], {}) == AuditResult(4, _check(items[:last_chunk], {}).head)


@pytest.mark.parametrize("number", range(12))
def test_audit_chain__each_removed_entry_is_named_by_its_position(number: int) -> None:
    items, summary = _recorded()
    del items[_entries(items)[number]]
    (problem,) = _check(items, summary).problems
    assert problem.startswith(f"entry {number + 1} is missing, ")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda item: item._replace(payload=b"other"), "entry 6 has changed (actuator/panel/a at 1970-01-01"),
        (lambda item: item._replace(time_ns=99), "entry 6 has changed"),
        (lambda item: item._replace(topic="actuator/plc/a"), "entry 6 has changed (actuator/plc/a"),
    ],
)
def test_audit_chain__changed_entry_is_named(change: Callable[[RecordedItem], RecordedItem], expected: str) -> None:
    items, summary = _recorded()
    place = _entries(items)[5]
    items[place] = change(items[place])
    (problem,) = _check(items, summary).problems
    assert problem.startswith(expected)


@pytest.mark.parametrize("kind", ["changed", "renamed", "later", "removed", "repeated", "moved", "among entries"])
def test_audit_chain__messages_that_are_no_entries_are_covered_as_well(kind: str) -> None:
    items, summary = _recorded()
    place = [place for place, item in enumerate(items) if item.schema == "Sample"][5]
    item = items[place]
    changed = {
        "changed": [item._replace(payload=b"1 2")],
        "renamed": [item._replace(topic="orders", schema="RecordedOrder")],
        "later": [item._replace(time_ns=item.time_ns + 1)],
        "removed": [],
        "repeated": [item, item],
    }
    if kind in changed:
        items[place : place + 1] = changed[kind]
    else:
        other = place + (2 if kind == "moved" else 1)
        items[place], items[other] = items[other], items[place]
    (problem,) = _check(items, summary).problems
    assert problem.startswith("samples, orders or the weather from 1970-01-01 00:00:00.000000 UTC to 1970")


@pytest.mark.parametrize(
    ("about", "attachments"),
    [
        (ABOUT | {"zenostat": "1.1"}, ATTACHMENTS),
        (ABOUT | {"root": "zenostat/room"}, ATTACHMENTS),
        (ABOUT, ATTACHMENTS | {"scenario.yaml": b"id: b"}),
        (ABOUT, ATTACHMENTS | {"geometry.msgpack": b""}),
        (ABOUT, {"manifest.json": b"{}", "scenario.yml": b"id: a"}),
        (ABOUT, {"manifest.json": b"{}"}),
    ],
)
def test_audit_chain__begins_with_versions_and_attachments(
    about: dict[str, str], attachments: dict[str, bytes]
) -> None:
    items, summary = _recorded()
    (problem,) = _check(items, summary, about=about, attachments=attachments).problems
    assert problem.startswith("what the file has before its messages has changed")
    assert _check(items, summary, attachments=dict(reversed(ATTACHMENTS.items()))).problems == []  # in any order


def test_audit_chain__samples_after_the_last_record_have_no_digest() -> None:
    items, _ = _recorded()
    items.append(RecordedItem("sample", "Sample", 99, b"forged"))
    (problem,) = _check(items, {}).problems
    assert problem.startswith("the 1 message from 1970-01-01")


def test_audit_chain__of_an_earlier_release_covers_the_entries() -> None:
    """Its links are those of records without the digest of all messages."""
    chain, items = AuditChain(), list[RecordedItem]()
    chain.add_channel(WRITES, "actuator/panel/a", "Write")
    for number in range(3):
        chain.add(WRITES, number, b"26.5")
        record = chain.seal()
        assert record is not None
        earlier = record.model_copy(update={"messages": b""})
        chain.resume(earlier)
        items.append(RecordedItem("sample", "Sample", number, b"%d" % number))
        items.append(RecordedItem("actuator/panel/a", "Write", number, b"26.5"))
        items.append(RecordedItem("audit", "RecordedAudit", number, codec.encode(earlier)))
    assert _check(items, chain.summary()).problems == []
    items[4] = items[4]._replace(payload=b"26.6")
    (problem,) = _check(items, chain.summary()).problems
    assert problem.startswith("entry 2 has changed")


def test_audit_chain__moved_and_added_entries_are_named() -> None:
    items, summary = _recorded()
    places = _entries(items)
    items[places[4]], items[places[5]] = items[places[5]], items[places[4]]
    (problem,) = _check(items, summary).problems
    assert problem.startswith("entry 5 has another one in its place")
    items, summary = _recorded()
    items.insert(places[7], items[places[7]]._replace(payload=b"forged"))
    (problem,) = _check(items, summary).problems
    assert problem.startswith("an entry without a digest was added (actuator/panel/a")
    items, summary = _recorded()
    items.insert(places[7], items[places[7]])
    assert _check(items, summary).problems == ["an entry after entry 4 is there more than once"]


def test_audit_chain__entries_that_are_removed_with_their_digests_are_missing_all_the_same() -> None:
    items, summary = _recorded()
    records = [place for place, item in enumerate(items) if item.schema == "RecordedAudit"]
    middle = items[: records[0] + 1] + items[records[1] + 1 :]
    assert _check(middle, summary).problems[0] == "entries 5 to 8 are missing with their digests"
    end = items[: records[1] + 1]
    assert _check(end, summary).problems == ["entries 9 to 12 are missing with their digests"]
    without = [item for item in items if item.schema != "RecordedAudit"]
    (problem, *_) = _check(without, summary).problems
    assert problem.startswith("12 entries after entry 0 have no digest")


def test_audit_chain__digests_that_are_forged_break_the_links() -> None:
    items, summary = _recorded()
    place = next(place for place, item in enumerate(items) if item.schema == "RecordedAudit")
    entry = _entries(items)[1]
    record = codec.decode(RecordedAudit, items[place].payload)
    digests = record.digests[:32] + record.digests[64:]
    items[place] = items[place]._replace(payload=codec.encode(record.model_copy(update={"digests": digests})))
    del items[entry]
    assert _check(items, summary).problems  # the next record's link and its position do not follow


def test_audit_chain__recording_of_an_earlier_release_has_none() -> None:
    items = [item for item in _recorded()[0] if item.schema != "RecordedAudit"]
    result = _check(items, {}, has_chain=False)
    assert (result.is_chained, result.problems) == (False, [])
