"""The format of recordings: MCAP files with the messages of one node, and the records that only files contain.

Each channel is named after the key of its messages, and its schema after their class; payloads are as they were on the
bus. All messages of a file are numbered (`sequence`), so a reader detects a gap.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import Claim, Mode
from zenostat.topics.messages.base import Count, Message, Raw, Seed, SourceName

PROFILE = "zenostat"
"""Profile in the header of the file."""

FORMAT = 1
"""Version of the file's format; raised if a reader of the previous one would misread the file."""

SUFFIX = ".mcap"

ABOUT, SUMMARY = "zenostat", "zenostat.summary"
"""Names of the metadata records: at the beginning of the file, and at its end if the recording was completed."""

MANIFEST, SCENARIO, PROVENANCE = "manifest.json", "scenario.yaml", "provenance.json"
GEOMETRY, SYSTEMS = "geometry.msgpack", "systems.msgpack"
"""Names of the attachments; only the recording of a plant with a geometry or systems has these, as the bus has them."""

WEATHER_COLUMNS = ("dry_bulb_temperature", "global_horizontal_radiation")
"""Columns of the weather that are recorded with an episode, in degC and Wh/m2 in the interval."""

AUDIT, AUDIT_ENTRIES, AUDIT_HEAD = "audit", "audit_entries", "audit_head"
"""Fields of the metadata records: the hash of the audit log's chain; in the summary, its length and its last link."""

AUDIT_HASH = "sha256"

ORDERS, EPISODES, SNAPSHOTS, OTHERS, WEATHER = "orders", "episodes", "snapshots", "others", "weather"
SENDERS, AUDIT_CHAIN, STATES = "senders", "audit", "states"
"""Channels, below the node's root, of the records that are not on the bus."""


class RecordedEpisode(Message):
    """The start of episodes in some slots; lists have one entry for each of `slots`.

    `inputs`: what a new plant needs to begin the same episode; empty where the plant cannot repeat one. `snapshot`: the
    snapshot that the node returned to; `step` is then the snapshot's. `source`: who asked for the reset.
    """

    slots: list[Count]
    episode: list[Count]
    step: list[Count]
    seeds: list[Seed | None]
    weather: list[str]
    inputs: list[dict[str, Any]] = Field(default_factory=list)
    snapshot: str = ""
    source: SourceName = ""


class RecordedState(Message):
    """State of a node, without its plant, when episodes began in all slots; the record of their start follows.

    `claims`: those of its controllers, all of which were connected. `alarms`: the alarm rules, as their file has them;
    None without any. `fault_episodes`: of each slot, the key of the random numbers of `faults`; empty without faults.
    """

    claims: list[Claim] = Field(default_factory=list)
    mode: Mode
    speed: float
    paused: bool = False
    alarms: dict[str, Any] | None = None
    faults: FaultPlan | None = None
    fault_episodes: list[list[Count]] = Field(default_factory=list)


class RecordedWeather(Message):
    """The weather of an episode in one slot, noise included; not recorded for a plant without weather.

    `step_s`: length of an interval in seconds. `values`: raw float64 of shape (intervals, columns), NaN where missing,
    each at the end of its interval, from the begin of the run period.
    """

    slot: Count
    episode: Count
    columns: list[str]
    units: list[str]
    step_s: float
    values: Raw


class RecordedOrder(Message):
    """The actuator values that a plant received for a timestep, after priorities, expiries and injected faults.

    `slots`: the slots that stepped. `values`: raw float64 of shape (all slots, actuators); NaN: relinquished.
    """

    slots: list[Count]
    values: Raw


class RecordedSnapshot(Message):
    """A snapshot that was taken, with the episode and the step of each slot."""

    snapshot: str
    episode: list[Count]
    step: list[Count]


class RecordedSender(Message):
    """A sender of the messages that follow: its name in their keys, and how it came to the bus.

    `proven`: the name that a certificate proves, where keys are in use: the sender's name is that, or below it; empty
    if nothing proves it. `via`: the way in, `zenoh` or the protocol of a gateway; of a gateway's clients, it is what
    the gateway says. It is recorded before a sender's first message, and whenever it changes.
    """

    sender: str
    proven: str = ""
    via: str = ""


class RecordedAudit(Message):
    """Digests of the messages since the previous such record; see `bridge/recording/audit_chain.py`.

    `first`: number of entries of the audit log before them. `previous`: link of the previous record, 32 bytes; in the
    first one the digest of the file's versions and attachments, zeros in recordings of earlier releases. `digests`: 32
    bytes for each entry, in the order of the file. `messages`: one digest of all messages, 32 bytes; empty in
    recordings of earlier releases.
    """

    first: Count
    previous: Raw
    digests: Raw
    messages: Raw = b""


class RecordedRequest(Message):
    """A request and its reply, both as they were sent; `reply_encoding` names the class of the reply."""

    payload: Raw
    encoding: str
    reply: Raw
    reply_encoding: str


class RecordedMessage(Message):
    """A received message without a channel of its own: its topic below the node's root, encoding and payload."""

    topic: str
    encoding: str
    payload: Raw
