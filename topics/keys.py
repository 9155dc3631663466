"""The table of topics: all key expressions of the bus, each defined once.

Root: `zenostat/v2/{node}`. Wildcards do not match chunks that begin with `@`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import (
    SCHEMA_VERSION,
    Ack,
    Acknowledge,
    AlarmList,
    AlarmQuery,
    Batch,
    BranchCreated,
    Claim,
    Command,
    CreateBranch,
    DropSnapshot,
    Event,
    Geometry,
    HistoryQuery,
    HistorySeries,
    Manifest,
    Message,
    Pause,
    PlanSimulated,
    PointValue,
    PriorityArrays,
    Query,
    RecordingStatus,
    RemoveFromService,
    Reset,
    Resume,
    ReturnToService,
    Sample,
    ScenarioText,
    SetPace,
    Shelve,
    SimulatePlan,
    SnapshotTaken,
    StartRecording,
    Status,
    StepRequest,
    StepsTried,
    Stop,
    StopRecording,
    TakeSnapshot,
    TrySteps,
    Unshelve,
    WeatherQuery,
    WeatherSeries,
    Write,
)
from zenostat.topics.printable import replace_controls

PREFIX = f"zenostat/v{SCHEMA_VERSION}"
NODE_CHUNK = 2
"""Index of the node's name among a key's chunks."""

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 7447
"""Where a node listens by default, over TCP or TLS."""


class Role(StrEnum):
    """Role of a program on the bus: sender of a topic, and common name of its certificate."""

    NODE = "node"
    CONTROLLER = "controller"
    MONITOR = "monitor"
    ANYONE = "anyone"


class Delivery(StrEnum):
    """Delivery of a topic's messages."""

    DROP = "drop"  # a slow subscriber loses messages; the publisher never waits
    BLOCK = "block"  # the publisher waits for a slow subscriber; no message is lost
    QUERY = "query"  # request and reply
    TOKEN = "token"  # liveliness token, no messages


@dataclass(frozen=True, slots=True)
class Topic:
    """A row of the table: key below the root, sender's role, classes of the message and of the reply, delivery."""

    key: str
    sender: Role
    message: type[Message] | None
    delivery: Delivery
    reply: type[Message] | None = None

    def at(self, node: str, *, name: str = "") -> str:
        """Return the full key expression; the name `*` matches all names."""
        return f"{PREFIX}/{node}/{self.key.replace('{name}', name)}"


MANIFEST = Topic("manifest", Role.NODE, Manifest, Delivery.BLOCK, reply=Manifest)
SAMPLE = Topic("sample", Role.NODE, Sample, Delivery.DROP, reply=Sample)
SENSOR = Topic("sensor/{name}", Role.NODE, PointValue, Delivery.DROP)
METER = Topic("meter/{name}", Role.NODE, PointValue, Delivery.DROP)
COMMAND = Topic("command/{name}", Role.CONTROLLER, Command, Delivery.BLOCK)
ACTUATOR = Topic("actuator/{name}", Role.ANYONE, Write, Delivery.BLOCK)
EVENT = Topic("event", Role.NODE, Event, Delivery.DROP)
BATCH = Topic("batch/stream", Role.NODE, Batch, Delivery.DROP)
CLAIM = Topic("rpc/claim", Role.CONTROLLER, Claim, Delivery.QUERY, reply=Ack)
RESET = Topic("rpc/reset", Role.CONTROLLER, Reset, Delivery.QUERY, reply=Ack)
SNAPSHOT = Topic("rpc/snapshot", Role.CONTROLLER, TakeSnapshot, Delivery.QUERY, reply=SnapshotTaken)
DROP = Topic("rpc/drop", Role.CONTROLLER, DropSnapshot, Delivery.QUERY, reply=Ack)
BRANCH = Topic("rpc/branch", Role.CONTROLLER, CreateBranch, Delivery.QUERY, reply=BranchCreated)
PLAN = Topic("rpc/plan", Role.CONTROLLER, SimulatePlan, Delivery.QUERY, reply=PlanSimulated)
TRY = Topic("rpc/try/{name}", Role.CONTROLLER, TrySteps, Delivery.QUERY, reply=StepsTried)
STOP = Topic("rpc/stop", Role.CONTROLLER, Stop, Delivery.QUERY, reply=Ack)
PACE = Topic("rpc/pace", Role.CONTROLLER, SetPace, Delivery.QUERY, reply=Ack)
PAUSE = Topic("rpc/pause", Role.CONTROLLER, Pause, Delivery.QUERY, reply=Ack)
RESUME = Topic("rpc/resume", Role.CONTROLLER, Resume, Delivery.QUERY, reply=Ack)
STEP = Topic("rpc/step", Role.CONTROLLER, StepRequest, Delivery.QUERY, reply=Ack)
COMMAND_REQUEST = Topic("rpc/command/{name}", Role.CONTROLLER, Command, Delivery.QUERY, reply=Ack)
WRITE_REQUEST = Topic("rpc/write/{name}", Role.CONTROLLER, Write, Delivery.QUERY, reply=Ack)
FAULTS = Topic("rpc/faults", Role.CONTROLLER, FaultPlan, Delivery.QUERY, reply=Ack)
RECORD = Topic("rpc/record", Role.CONTROLLER, StartRecording, Delivery.QUERY, reply=RecordingStatus)
STOP_RECORDING = Topic("rpc/stop_recording", Role.CONTROLLER, StopRecording, Delivery.QUERY, reply=RecordingStatus)
STATUS = Topic("rpc/status", Role.ANYONE, Query, Delivery.QUERY, reply=Status)
SCENARIO = Topic("rpc/scenario", Role.ANYONE, Query, Delivery.QUERY, reply=ScenarioText)
WEATHER = Topic("rpc/weather", Role.ANYONE, WeatherQuery, Delivery.QUERY, reply=WeatherSeries)
ALARMS = Topic("rpc/alarms", Role.ANYONE, AlarmQuery, Delivery.QUERY, reply=AlarmList)
ACKNOWLEDGE = Topic("rpc/acknowledge", Role.CONTROLLER, Acknowledge, Delivery.QUERY, reply=Ack)
SHELVE = Topic("rpc/shelve", Role.CONTROLLER, Shelve, Delivery.QUERY, reply=Ack)
UNSHELVE = Topic("rpc/unshelve", Role.CONTROLLER, Unshelve, Delivery.QUERY, reply=Ack)
REMOVE_FROM_SERVICE = Topic("rpc/remove_from_service", Role.CONTROLLER, RemoveFromService, Delivery.QUERY, reply=Ack)
RETURN_TO_SERVICE = Topic("rpc/return_to_service", Role.CONTROLLER, ReturnToService, Delivery.QUERY, reply=Ack)
HISTORY = Topic("rpc/history", Role.ANYONE, HistoryQuery, Delivery.QUERY, reply=HistorySeries)
GEOMETRY = Topic("rpc/geometry", Role.ANYONE, Query, Delivery.QUERY, reply=Geometry)
PRIORITIES = Topic("rpc/priorities", Role.ANYONE, Query, Delivery.QUERY, reply=PriorityArrays)
NODE_TOKEN = Topic("@live/node/{name}", Role.NODE, None, Delivery.TOKEN)
CONTROLLER_TOKEN = Topic("@live/controller/{name}", Role.CONTROLLER, None, Delivery.TOKEN)
GATEWAY_TOKEN = Topic("@live/gateway/{name}", Role.CONTROLLER, None, Delivery.TOKEN)

TOPICS = (
    MANIFEST,
    SAMPLE,
    SENSOR,
    METER,
    COMMAND,
    ACTUATOR,
    EVENT,
    BATCH,
    CLAIM,
    RESET,
    SNAPSHOT,
    DROP,
    BRANCH,
    PLAN,
    TRY,
    STOP,
    PACE,
    PAUSE,
    RESUME,
    STEP,
    COMMAND_REQUEST,
    WRITE_REQUEST,
    FAULTS,
    RECORD,
    STOP_RECORDING,
    STATUS,
    SCENARIO,
    WEATHER,
    HISTORY,
    ALARMS,
    ACKNOWLEDGE,
    SHELVE,
    UNSHELVE,
    REMOVE_FROM_SERVICE,
    RETURN_TO_SERVICE,
    GEOMETRY,
    PRIORITIES,
    NODE_TOKEN,
    CONTROLLER_TOKEN,
    GATEWAY_TOKEN,
)

OWN_STREAM = "*"
"""Key expression, below a node's root, of the topics with one chunk (manifest, sample, event), in the order sent."""

WAKE = "wake"
"""Prefix of the keys, below a node's root, with which a process wakes its own receivers; never sent to others."""


def is_streamed(topic: Topic) -> bool:
    """Return whether a topic is one of a node's stream: manifest, sample or event."""
    return "/" not in topic.key


def stream(node: str) -> str:
    """Return the key expression of a node's topics with one chunk; `*` matches all nodes."""
    return f"{root(node)}/{OWN_STREAM}"


def wake(node: str, receiver: int) -> str:
    """Return the key with which a process wakes one of its receivers of a node's stream; each has a number."""
    return f"{root(node)}/{WAKE}-{receiver}"


def root(node: str) -> str:
    """Return a node's root: `zenostat/v2/{node}`."""
    return f"{PREFIX}/{node}"


def node_of(key: str) -> str:
    """Return the node's name in a full key, without control characters."""
    return replace_controls(key.split("/")[NODE_CHUNK])


def last_chunk(key: str) -> str:
    """Return the last chunk of a full key, the name of a point, a controller or an instance: no control characters."""
    return replace_controls(key.rsplit("/", 1)[1])


_UNSAFE = re.compile(r"[^A-Za-z0-9_.\-]+")
_SAFE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,127}")


def safe_name(text: str) -> str:
    """Convert a text to a valid chunk of a key: in lower case, with `_` for characters that are not allowed."""
    return _UNSAFE.sub("_", text).strip("_.-").lower()[:128] or "x"


def check_name(name: str, what: str) -> str:
    """Return a name that is valid as a chunk of a key.

    Raises:
        InvalidConfig: the name is not valid.
    """
    if not _SAFE.fullmatch(name):
        raise InvalidConfig(
            f"{what} {name!r} is not valid in a topic: use up to 128 letters, digits, '_', '.' and '-'; "
            f"for example {safe_name(name)!r}"
        )
    return name
