"""The table of topics: all key expressions of the bus, each defined once.

Root: `zenostat/v3/{node}`. Wildcards do not match chunks that begin with `@`.

Each message that changes something names its sender in its key, so that an access rule can bind it: `{sender}` is the
name in the sender's certificate (`ppo-7`), or a name below it (`ppo-7.agent`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from zenostat.topics.errors import InvalidConfig
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import (
    ANONYMOUS,
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
    Revoke,
    Sample,
    ScenarioText,
    SemanticModel,
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
    Systems,
    TakeSnapshot,
    TrySteps,
    Unshelve,
    WeatherQuery,
    WeatherSeries,
    Write,
)
from zenostat.topics.printable import replace_controls

PREFIX = f"zenostat/v{SCHEMA_VERSION}"
SENDER, NAME = "{sender}", "{name}"
"""Placeholders in a topic's key."""

NODE_CHUNK = 2
"""Index of the node's name among a key's chunks."""

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 7447
"""Where a node listens by default, over TCP or TLS."""


class Role(StrEnum):
    """Role of a program or a person on the bus: who may send on a topic, and what a certificate permits.

    `NODE` is trusted with all messages. `CONTROLLER` claims, commands, simulates copies. `OPERATOR` writes, resets,
    stops, and sets pace, faults, alarms and recordings. `MONITOR` reads. `GATEWAY` sends what a controller and an
    operator may, for clients of other protocols. `ANYONE`, any of them, is no role of a certificate.
    """

    NODE = "node"
    CONTROLLER = "controller"
    OPERATOR = "operator"
    MONITOR = "monitor"
    GATEWAY = "gateway"
    ANYONE = "anyone"


class Delivery(StrEnum):
    """Delivery of a topic's messages."""

    DROP = "drop"  # a slow subscriber loses messages; the publisher never waits
    BLOCK = "block"  # the publisher waits for a slow subscriber; no message is lost
    QUERY = "query"  # request and reply
    TOKEN = "token"  # liveliness token, no messages


@dataclass(frozen=True, slots=True)
class Topic:
    """A row of the table: key below the root, sender's role, classes of the message and of the reply, delivery.

    Attributes:
        key: `{sender}` stands for the sender's name, `{name}` for that of a point or an instance.
        sender: the role that may send the message, or query.
        message, delivery, reply: of the topic.
        also: a further role that may send it.
    """

    key: str
    sender: Role
    message: type[Message] | None
    delivery: Delivery
    reply: type[Message] | None = None
    also: Role | None = None

    @property
    def has_sender(self) -> bool:
        """Whether a message changes something, and its key has the sender's name."""
        return SENDER in self.key

    @property
    def senders(self) -> tuple[Role, ...]:
        """The roles that may send it."""
        return (self.sender,) if self.also is None else (self.sender, self.also)

    def below(self, *, name: str = "", sender: str = "") -> str:
        """Return the key below the node's root."""
        return self.key.replace(SENDER, sender).replace(NAME, name)

    def at(self, node: str, *, name: str = "", sender: str = "") -> str:
        """Return the full key expression; the name or the sender `*` matches all of them."""
        return f"{PREFIX}/{node}/{self.below(name=name, sender=sender)}"

    def everywhere(self, node: str = "*") -> str:
        """Return the key expression of all names and all senders, by default on all nodes."""
        return self.at(node, name="*", sender="*")

    def names_in(self, key: str) -> tuple[str, str]:
        """Return sender and name in a full key of this topic, without control characters; empty where it has none."""
        sender, name = self.chunks_in(key)
        return replace_controls(sender), replace_controls(name)

    def chunks_in(self, key: str) -> tuple[str, str]:
        """Return sender and name in a full key of this topic as they are, of which `at` makes the key again."""
        *_, before, last = "*", *key.split("/")  # "**" is a key of every topic
        if self.key.endswith(NAME):
            return (before if self.has_sender else ""), last
        return (last if self.has_sender else ""), ""


MANIFEST = Topic("manifest", Role.NODE, Manifest, Delivery.BLOCK, reply=Manifest)
SAMPLE = Topic("sample", Role.NODE, Sample, Delivery.DROP, reply=Sample)
SENSOR = Topic("sensor/{name}", Role.NODE, PointValue, Delivery.DROP)
METER = Topic("meter/{name}", Role.NODE, PointValue, Delivery.DROP)
COMMAND = Topic("command/{sender}", Role.CONTROLLER, Command, Delivery.BLOCK)
ACTUATOR = Topic("actuator/{sender}/{name}", Role.OPERATOR, Write, Delivery.BLOCK)
EVENT = Topic("event", Role.NODE, Event, Delivery.DROP)
BATCH = Topic("batch/stream", Role.NODE, Batch, Delivery.DROP)
CLAIM = Topic("rpc/claim/{sender}", Role.CONTROLLER, Claim, Delivery.QUERY, reply=Ack)
RESET = Topic("rpc/reset/{sender}", Role.OPERATOR, Reset, Delivery.QUERY, reply=Ack)
SNAPSHOT = Topic("rpc/snapshot/{sender}", Role.CONTROLLER, TakeSnapshot, Delivery.QUERY, reply=SnapshotTaken)
DROP_SNAPSHOT = Topic("rpc/drop/{sender}", Role.CONTROLLER, DropSnapshot, Delivery.QUERY, reply=Ack, also=Role.OPERATOR)
"""Controllers drop their own snapshots with it, and operators any."""
BRANCH = Topic("rpc/branch/{sender}", Role.CONTROLLER, CreateBranch, Delivery.QUERY, reply=BranchCreated)
PLAN = Topic("rpc/plan/{sender}", Role.CONTROLLER, SimulatePlan, Delivery.QUERY, reply=PlanSimulated)
TRY = Topic("rpc/try/{sender}", Role.CONTROLLER, TrySteps, Delivery.QUERY, reply=StepsTried)
STOP = Topic("rpc/stop/{sender}", Role.OPERATOR, Stop, Delivery.QUERY, reply=Ack, also=Role.CONTROLLER)
"""Controllers end their own branches with it."""
PACE = Topic("rpc/pace/{sender}", Role.OPERATOR, SetPace, Delivery.QUERY, reply=Ack)
PAUSE = Topic("rpc/pause/{sender}", Role.OPERATOR, Pause, Delivery.QUERY, reply=Ack)
RESUME = Topic("rpc/resume/{sender}", Role.OPERATOR, Resume, Delivery.QUERY, reply=Ack)
STEP = Topic("rpc/step/{sender}", Role.OPERATOR, StepRequest, Delivery.QUERY, reply=Ack)
COMMAND_REQUEST = Topic("rpc/command/{sender}", Role.CONTROLLER, Command, Delivery.QUERY, reply=Ack)
WRITE_REQUEST = Topic("rpc/write/{sender}/{name}", Role.OPERATOR, Write, Delivery.QUERY, reply=Ack)
FAULTS = Topic("rpc/faults/{sender}", Role.OPERATOR, FaultPlan, Delivery.QUERY, reply=Ack)
FAULT_PLAN = Topic("rpc/fault_plan", Role.ANYONE, Query, Delivery.QUERY, reply=FaultPlan)
RECORD = Topic("rpc/record/{sender}", Role.OPERATOR, StartRecording, Delivery.QUERY, reply=RecordingStatus)
STOP_RECORDING = Topic(
    "rpc/stop_recording/{sender}", Role.OPERATOR, StopRecording, Delivery.QUERY, reply=RecordingStatus
)
STATUS = Topic("rpc/status", Role.ANYONE, Query, Delivery.QUERY, reply=Status)
SCENARIO = Topic("rpc/scenario", Role.ANYONE, Query, Delivery.QUERY, reply=ScenarioText)
WEATHER = Topic("rpc/weather", Role.ANYONE, WeatherQuery, Delivery.QUERY, reply=WeatherSeries)
ALARMS = Topic("rpc/alarms", Role.ANYONE, AlarmQuery, Delivery.QUERY, reply=AlarmList)
ACKNOWLEDGE = Topic("rpc/acknowledge/{sender}", Role.OPERATOR, Acknowledge, Delivery.QUERY, reply=Ack)
SHELVE = Topic("rpc/shelve/{sender}", Role.OPERATOR, Shelve, Delivery.QUERY, reply=Ack)
UNSHELVE = Topic("rpc/unshelve/{sender}", Role.OPERATOR, Unshelve, Delivery.QUERY, reply=Ack)
REMOVE_FROM_SERVICE = Topic(
    "rpc/remove_from_service/{sender}", Role.OPERATOR, RemoveFromService, Delivery.QUERY, reply=Ack
)
RETURN_TO_SERVICE = Topic("rpc/return_to_service/{sender}", Role.OPERATOR, ReturnToService, Delivery.QUERY, reply=Ack)
REVOKE = Topic("rpc/revoke/{sender}", Role.OPERATOR, Revoke, Delivery.QUERY, reply=Ack)
HISTORY = Topic("rpc/history", Role.ANYONE, HistoryQuery, Delivery.QUERY, reply=HistorySeries)
GEOMETRY = Topic("rpc/geometry", Role.ANYONE, Query, Delivery.QUERY, reply=Geometry)
SEMANTIC = Topic("rpc/semantic", Role.ANYONE, Query, Delivery.QUERY, reply=SemanticModel)
SYSTEMS = Topic("rpc/systems", Role.ANYONE, Query, Delivery.QUERY, reply=Systems)
PRIORITIES = Topic("rpc/priorities", Role.ANYONE, Query, Delivery.QUERY, reply=PriorityArrays)
NODE_TOKEN = Topic("@live/node/{name}", Role.NODE, None, Delivery.TOKEN)
CONTROLLER_TOKEN = Topic("@live/controller/{sender}", Role.CONTROLLER, None, Delivery.TOKEN)
GATEWAY_TOKEN = Topic("@live/gateway/{sender}/{name}", Role.GATEWAY, None, Delivery.TOKEN)

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
    DROP_SNAPSHOT,
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
    FAULT_PLAN,
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
    REVOKE,
    GEOMETRY,
    SEMANTIC,
    SYSTEMS,
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
    """Return a node's root: `zenostat/v3/{node}`."""
    return f"{PREFIX}/{node}"


def node_of(key: str) -> str:
    """Return the node's name in a full key, without control characters; empty if the key is too short to have one."""
    return replace_controls("".join(key.split("/")[NODE_CHUNK : NODE_CHUNK + 1]))


def below_node(key: str) -> str:
    """Return the part of a full key after the node's name, as `Topic.below`; empty if it is shorter."""
    return "/".join(key.split("/")[NODE_CHUNK + 1 :])


def last_chunk(key: str) -> str:
    """Return the last chunk of a full key, the name of a point, a controller or an instance: no control characters."""
    return replace_controls(key.rpartition("/")[2])


_UNSAFE = re.compile(r"[^A-Za-z0-9_.\-]+")
MAX_NAME = 128
"""Largest number of characters of a name."""

_SAFE = re.compile(rf"[A-Za-z0-9_][A-Za-z0-9_.\-]{{0,{MAX_NAME - 1}}}")


def safe_name(text: str) -> str:
    """Convert a text to a valid chunk of a key: in lower case, with `_` for characters that are not allowed."""
    return _UNSAFE.sub("_", text).strip("_.-").lower()[:MAX_NAME] or "x"


def is_name(name: str) -> bool:
    """Return whether a name is valid as a chunk of a key."""
    return _SAFE.fullmatch(name) is not None


def shortened(name: str) -> str:
    """Return a name; of one that is too long, its beginning and an ellipsis, which no valid name has."""
    return name if len(name) <= MAX_NAME else f"{name[: MAX_NAME - 1]}…"


def is_own(identity: str, name: str) -> bool:
    """Return whether the holder of a certificate may send under a name: the certificate's, or one below it."""
    return name == identity or name.startswith(f"{identity}.")


def own_name(identity: str, name: str) -> str:
    """Return a sender's name: below the certificate's name where there is a certificate, else as it is chosen.

    Args:
        identity: the name in the certificate; empty without one.
        name: the name that the program chose; empty if it chose none.
    """
    if not identity:
        return name or ANONYMOUS
    return name if is_own(identity, name) else f"{identity}.{name}" if name else identity


def sender_field(kind: type[Message]) -> str:
    """Return the field of a message that has its sender's name; empty if it has none."""
    return next((field for field in ("controller", "source") if field in kind.model_fields), "")


def check_name(name: str, what: str) -> str:
    """Return a name that is valid as a chunk of a key.

    Raises:
        InvalidConfig: the name is not valid.
    """
    if not isinstance(name, str):
        raise InvalidConfig(f"{what} {name!r} is not a text")
    if not _SAFE.fullmatch(name):
        raise InvalidConfig(
            f"{what} {shortened(name)!r} is not valid in a topic: use up to {MAX_NAME} letters, digits, '_', '.' and "
            f"'-', of which the first is no '.' or '-'; for example {safe_name(name)!r}"
        )
    return name
