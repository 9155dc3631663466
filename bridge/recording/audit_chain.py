"""The hash chain of a recording: a removed, changed or moved message is found when the file is verified.

An entry of the audit log is a recorded message of any kind but samples, orders and the weather, which a simulation
repeats. The digest of a message is the SHA-256 of its topic, a zero byte, its time (8 bytes, little-endian) and its
payload. With each chunk, the recorder writes a `RecordedAudit` with the link of the previous one, the digests of the
entries since then, which name the one that has changed, and the SHA-256 of the digests of all messages since then; the
link of a record is the SHA-256 of the three. The link before the first one is the digest of what the file has before
its messages: versions and attachments. So each link depends on all that is before it, and a file that was cut off is
unbroken up to its last chunk. The last link, the head, is in the file's summary.

The chain has no secret: who can write the file can compute another chain. Whoever keeps the head elsewhere finds
that as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from typing import TYPE_CHECKING

from zenostat.topics import codec, recording
from zenostat.topics.errors import BadMessage
from zenostat.topics.plurals import counted
from zenostat.topics.printable import replace_controls
from zenostat.topics.recording import RecordedAudit

if TYPE_CHECKING:
    from zenostat.bridge.recording.reader import RecordedItem, RecordingReader

SIZE = 32
"""Bytes of a digest and of a link."""

MAX_PROBLEMS = 20
"""Largest number of problems that are reported."""

_START = bytes(SIZE)
"""The link before the first one in recordings of earlier releases, whose chain has only messages."""

_AUDIT = RecordedAudit.__name__
_NO_ENTRIES = frozenset(("Sample", "RecordedOrder", "RecordedWeather", _AUDIT))


def is_entry(schema: str) -> bool:
    """Return whether messages of a class are entries of the audit log."""
    return schema not in _NO_ENTRIES


def digest(topic: bytes, time_ns: int, payload: bytes) -> bytes:
    """Return the digest of a message."""
    return sha256(b"%b\0%b%b" % (topic, time_ns.to_bytes(8, "little"), payload)).digest()


def beginning(about: Mapping[str, str], attachments: Mapping[str, bytes]) -> bytes:
    """Return the digest of what a file has before its messages, by names: its metadata and its attachments.

    It is the SHA-256 of the digests of all names and contents (as those of messages at time 0), ordered by name.
    """
    texts = {name: text.encode() for name, text in about.items()}
    each = [digest(name.encode(), 0, part) for group in (texts, attachments) for name, part in sorted(group.items())]
    return _digest_of_all(each)


def _link(record: RecordedAudit) -> bytes:
    return sha256(record.previous + record.digests + record.messages).digest()


def _digest_of_all(digests: list[bytes]) -> bytes:
    return sha256(b"".join(digests)).digest()


class AuditChain:
    """The chain while it is written.

    Attributes:
        head: the link of the latest record.
        entries: number of entries so far.
    """

    def __init__(self) -> None:
        self.head, self.entries = _START, 0
        self._topics: dict[int, bytes] = {}
        self._entry_channels: set[int] = set()
        self._digests: list[bytes] = []
        self._messages: list[bytes] = []

    def begin(self, about: Mapping[str, str], attachments: Mapping[str, bytes]) -> None:
        """Begin the chain with what the file has before its messages."""
        self.head = beginning(about, attachments)

    def resume(self, record: RecordedAudit) -> None:
        """Go on after a record of the chain."""
        self.entries = record.first + len(record.digests) // SIZE
        self.head = _link(record)

    def add_channel(self, channel: int, topic: str, schema: str) -> None:
        """Chain the messages of a channel, unless it is that of the chain."""
        if schema == _AUDIT:
            return
        self._topics[channel] = replace_controls(topic).encode()  # as a reader has it
        if is_entry(schema):
            self._entry_channels.add(channel)

    def add(self, channel: int, time_ns: int, payload: bytes) -> None:
        """Add a message."""
        topic = self._topics.get(channel)
        if topic is None:
            return
        each = digest(topic, time_ns, payload)
        self._messages.append(each)
        if channel in self._entry_channels:
            self._digests.append(each)

    def seal(self) -> RecordedAudit | None:
        """Return the record of the messages since the latest one; None if there are none."""
        if not self._messages:
            return None
        record = RecordedAudit(
            first=self.entries,
            previous=self.head,
            digests=b"".join(self._digests),
            messages=_digest_of_all(self._messages),
        )
        self.entries += len(self._digests)
        self.head = _link(record)
        self._digests, self._messages = [], []
        return record

    def summary(self) -> dict[str, str]:
        """Return the fields of the file's summary."""
        return {recording.AUDIT_ENTRIES: str(self.entries), recording.AUDIT_HEAD: self.head.hex()}


@dataclass(slots=True)
class AuditResult:
    """Result of checking the chain of an audit log.

    Attributes:
        entries: number of entries.
        head: the last link in hexadecimal digits; empty if the recording has no chain.
        problems: what is wrong, with the position of each entry from 1, in the order of the file.
    """

    entries: int = 0
    head: str = ""
    problems: list[str] = field(default_factory=list)

    @property
    def is_chained(self) -> bool:
        """Whether the recording has a chain; earlier releases wrote none."""
        return bool(self.head)

    def __str__(self) -> str:
        if not self.is_chained and not self.problems:
            return "audit log: not chained, as of an earlier release"
        if self.problems:
            more = f"; and {len(self.problems) - MAX_PROBLEMS} more" if len(self.problems) > MAX_PROBLEMS else ""
            return f"audit log: broken: {'; '.join(self.problems[:MAX_PROBLEMS])}{more}"
        return f"audit log: unbroken, {self.entries:,} entries, head {self.head}"


def check_audit(reader: RecordingReader) -> AuditResult:
    """Read a recording to its end, and check the chain of its audit log."""
    check = _Check(beginning(reader.versions, reader.attachments), has_chain=recording.AUDIT in reader.about)
    for item in reader.messages():
        if item.schema == _AUDIT:
            check.add_record(item)
        else:
            check.add(item)
    return check.finish(reader.end.metadata)


class _Check:
    """The chain while it is read."""

    def __init__(self, beginning: bytes, *, has_chain: bool) -> None:
        self._has_chain, self._head, self._expected, self._previous = has_chain, beginning, 0, ""
        self._has_records = False
        self.entries: list[RecordedItem] = []
        self._digests: list[bytes] = []
        self._messages: list[bytes] = []
        self._first: RecordedItem | None = None
        self._covers_all = False
        self._problems: list[str] = []

    def add(self, item: RecordedItem) -> None:
        """Add a message that a record will follow."""
        each = digest(item.topic.encode(), item.time_ns, item.payload)
        self._messages.append(each)
        self._first = self._first or item
        if is_entry(item.schema):
            self.entries.append(item)
            self._digests.append(each)

    def add_record(self, item: RecordedItem) -> None:
        """Compare the messages since the previous record with a record's digests."""
        try:
            record = codec.decode(RecordedAudit, item.payload)
        except BadMessage as error:
            self._problems.append(f"the record after entry {self._expected:,} cannot be read ({error})")
            return
        is_first = not self._has_records and not record.first
        self._has_chain = self._has_records = True
        if is_first:
            if record.previous not in (self._head, _START):
                self._problems.append(
                    "what the file has before its messages has changed: its versions, manifest, scenario, provenance, "
                    "geometry or systems"
                )
        elif record.first > self._expected:
            self._problems.append(f"entries {self._expected + 1:,} to {record.first:,} are missing with their digests")
        elif record.previous != self._head or record.first < self._expected:
            self._problems.append(f"the chain is not continued after entry {self._expected:,}{self._previous}")
        digests = [record.digests[at : at + SIZE] for at in range(0, len(record.digests), SIZE)]
        self._covers_all = bool(record.messages)
        if digests != self._digests:
            self._compare(record.first, digests)
        elif record.messages and record.messages != _digest_of_all(self._messages):
            self._report_others(item)
        self._head, self._expected = _link(record), record.first + len(digests)
        if self.entries:
            self._previous = f" ({_describe(self.entries[-1])})"
        self.entries, self._digests, self._messages, self._first = [], [], [], None

    def _report_others(self, record: RecordedItem) -> None:
        """Report messages that are no entries, of which only all together have a digest."""
        first = "at the beginning" if self._first is None else f"from {_time(self._first)}"
        self._problems.append(
            f"samples, orders or the weather {first} to {_time(record)} have changed, or messages there are missing, "
            "added or in another order"
        )

    def _compare(self, first: int, digests: list[bytes]) -> None:
        """Report each entry that has no digest, and each digest without its entry, by position."""
        present = self._digests
        known, recorded = set(present), set(digests)
        lost = [place for place, each in enumerate(digests) if each not in known]
        foreign = [place for place, each in enumerate(present) if each not in recorded]
        changed = min(len(lost), len(foreign)) if len(present) == len(digests) else 0
        for place, at in zip(lost[:changed], foreign[:changed], strict=True):
            self._problems.append(f"entry {first + place + 1:,} has changed ({_describe(self.entries[at])})")
        for place in lost[changed:]:
            self._problems.append(f"entry {first + place + 1:,} is missing{self._around(place, digests, present)}")
        for place in foreign[changed:]:
            self._problems.append(f"an entry without a digest was added ({_describe(self.entries[place])})")
        if not lost and not foreign:
            self._report_order(first, digests, present)

    def _around(self, place: int, digests: list[bytes], present: list[bytes]) -> str:
        """Return the entry before or after a missing one."""
        places = {each: at for at, each in enumerate(present)}
        before = next((places[each] for each in reversed(digests[:place]) if each in places), None)
        if before is not None:
            return f", after {_describe(self.entries[before])}"
        after = next((places[each] for each in digests[place + 1 :] if each in places), None)
        return "" if after is None else f", before {_describe(self.entries[after])}"

    def _report_order(self, first: int, digests: list[bytes], present: list[bytes]) -> None:
        if len(digests) != len(present):
            self._problems.append(f"an entry after entry {first:,} is there more than once")
            return
        for place, (expected, actual) in enumerate(zip(digests, present, strict=True)):
            if expected != actual:
                described = _describe(self.entries[place])
                self._problems.append(f"entry {first + place + 1:,} has another one in its place ({described})")
                return

    def finish(self, summary: Mapping[str, str]) -> AuditResult:
        """Return the result, with what the file's summary says of the end."""
        problems = self._problems
        if not self._has_chain:
            return AuditResult(len(self.entries))
        if self.entries:
            problems.append(
                f"{len(self.entries):,} entries after entry {self._expected:,} have no digest; the first is "
                f"{_describe(self.entries[0])}"
            )
        elif self._covers_all and self._first is not None:
            problems.append(
                f"the {counted(len(self._messages), 'message', ',')} from {_time(self._first)} on have no digest"
            )
        count, head = summary.get(recording.AUDIT_ENTRIES, ""), summary.get(recording.AUDIT_HEAD, "")
        if count.isdecimal() and int(count) > self._expected:
            problems.append(f"entries {self._expected + 1:,} to {int(count):,} are missing with their digests")
        elif head and head != self._head.hex():
            problems.append("the last link is not that of the file's summary")
        return AuditResult(self._expected, self._head.hex(), problems)


def _describe(item: RecordedItem) -> str:
    return f"{item.topic} at {_time(item)}"


def _time(item: RecordedItem) -> str:
    return f"{datetime.fromtimestamp(item.time_ns / 1e9, UTC):%Y-%m-%d %H:%M:%S.%f} UTC"
