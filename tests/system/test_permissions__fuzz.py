"""A node stays as it is, to the bit, while certificates of the wrong role send anything on topics of other roles.

A controller runs the same day again and again, in lockstep, first alone, then beside four programs that send whatever
`support.role_fuzzer` draws, each on the topics that its role may not use. `ROLE_FUZZ_SECONDS` sets the time for all
topics together; with `ROLE_FUZZ_TOPIC_SECONDS` each topic is also fuzzed by itself, for that long. `FUZZ_SEED` repeats
a run.
"""

import json
import os
import random
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgpack
import psutil
import pytest
from support import role_fuzzer
from support.nodes import NodeProgram, free_port, size_of, until

import zenostat
from zenostat import Bus, ControllerLink
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.transport.access_control import Permission, may
from zenostat.bridge.transport.deny_list import read_revoked
from zenostat.topics import keys
from zenostat.topics.keys import REVOKE, STOP, TOPICS, Delivery, Role, Topic
from zenostat.topics.messages import CreateBranch
from zenostat.topics.recording import RecordedAudit

SEED = int(os.environ.get("FUZZ_SEED", "0")) or random.SystemRandom().randrange(1, 2**31)
ALL_S = float(os.environ.get("ROLE_FUZZ_SECONDS", "60"))
TOPIC_S = float(os.environ.get("ROLE_FUZZ_TOPIC_SECONDS", "0"))
QUICK_S = 1.0

PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
CERTIFICATES = {"second": Role.CONTROLLER, "operator": Role.OPERATOR, "monitor": Role.MONITOR, "gateway": Role.GATEWAY}
SENDS = {Permission.SEND, Permission.ASK, Permission.SHOW}
ALARMS = """
alarms:
  - {name: hot, points: zone_1_air_temperature, high: 24.0, unit: degC}
  - {name: cold, points: zone_1_air_temperature, low: 20.5, unit: degC}
"""
LONG = [
    pytest.param(ALL_S, TOPICS, id="all topics"),
    *(pytest.param(TOPIC_S, [t], id=t.key) for t in TOPICS if TOPIC_S and t.sender is not Role.ANYONE),
]
"""Seconds and topics of the long runs; topics that every role may query have no wrong role."""

POINT = "zone_1_cooling_setpoint"


class RoleFuzzer:
    """A program that fuzzes with certificates of the wrong roles, in rounds.

    Args:
        topics: the keys of the topics by certificate.
        settings: of the program.
    """

    def __init__(self, topics: dict[str, list[str]], **settings: str | int) -> None:
        self.sent = Counter[str]()
        self.process = subprocess.Popen(
            [sys.executable, "-P", role_fuzzer.__file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._write(json.dumps({"topics": topics, **settings}))
        assert self.process.stdout.readline() == "ready\n"

    def __enter__(self) -> "RoleFuzzer":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def _write(self, line: str) -> None:
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def begin_round(self) -> None:
        self._write("")

    def end_round(self) -> None:
        """Wait until the node has received the round, whose last message is a query that it answers."""
        line = self.process.stdout.readline()
        assert line, "the fuzzer has ended"
        answer = json.loads(line)
        assert answer["answered"], "the node does not answer"
        self.sent = Counter(answer["sent"])


@pytest.fixture(scope="module")
def node(module_folder: Path, pki: Path) -> Iterator[NodeProgram]:
    """A node with a state that could be changed: alarms, a fault, a pace, a written value, a snapshot, a recording."""
    (module_folder / "alarms.yaml").write_text(ALARMS)
    listen = [f"tls/127.0.0.1:{free_port()}"]
    settings = {"plant": PLANT, "listen": listen, "keys": str(pki), "alarms": f"{module_folder}/alarms.yaml"}
    with NodeProgram(module_folder / "node", **settings) as running:
        yield running


def day(link: ControllerLink) -> list[tuple[Any, ...]]:
    """Simulate a day; return what its samples have, besides the number of the episode."""
    sample, seen = link.reset(seed=0), []
    while True:
        message = sample.message
        seen.append((message.values, message.fault_free_values, message.effective, message.source_index,
                     message.sources, message.flags, message.time))  # fmt: skip
        if sample.truncated:
            return seen
        sample.send({POINT: 24.0 + sample.step % 3})
        sample = link.receive()


def prepare(bus: Bus, operator: Bus) -> ControllerLink:
    """Give the node a state that messages could change: a fault, values, an alarm set aside, a snapshot, a branch."""
    link = bus.controller("office", name="day")
    link.reset(seed=0)
    bus.faults("office", {"faults": [{"kind": "bias", "points": "zone_2_air_temperature", "offset": 0.5}]})
    operator.write("office", POINT, 25.5, priority=12, source="panel")
    operator.shelve("office", "cold", duration_s=3600.0, comment="test")
    bus.snapshot("office", link.name)
    bus.branch("office", CreateBranch(controller=link.name))
    return link


def state(bus: Bus, pki: Path) -> dict[str, Any]:
    """Return everything of a node that a message could change, besides the count of episodes and commands."""
    status = bus.status("office")
    gateways = [str(reply.ok.key_expr) for reply in bus.session.liveliness().get(keys.GATEWAY_TOKEN.everywhere())]
    return {
        "pace": (status.mode, status.speed, status.paused, status.policy, status.state, status.step),
        "claims": [
            (c.controller, c.state, c.priority, c.actuators, c.required, c.rejected) for c in status.controllers
        ],
        "counts": (status.rejected, status.late, status.duplicate, status.statistics.rate_limited),
        "faults": status.faults,
        "copies": ([s.name for s in status.snapshots], [b.name for b in status.branches]),
        "recording": (status.recording.path, status.recording.state),
        "priorities": bus.priorities("office"),
        "alarms": bus.alarms("office").alarms,
        "presence": (bus.nodes(), bus.controllers(), gateways),
        "revoked": read_revoked(pki),
    }


def recorded_days(path: Path) -> list[list[tuple[str, str, Any]]]:
    """Return the messages of each complete day of a recording, without wall times, numbers of episodes and digests."""
    days: list[list[tuple[str, str, Any]]] = []
    with RecordingReader(path) as reader:
        for item in reader.messages():
            if item.schema == RecordedAudit.__name__:
                continue  # it digests wall times
            content = msgpack.unpackb(item.payload)
            if item.topic == "episodes":
                days.append([])
            if days:
                days[-1].append((item.topic, item.schema, without_episode(content)))
    return days


def without_episode(content: dict[str, Any]) -> dict[str, Any]:
    if "text" in content:
        content["text"] = re.sub(r"episode \d+", "episode", content["text"])
    return {name: value for name, value in content.items() if name not in ("episode", "reply")}


def fuzz(folder: Path, node: NodeProgram, bus: Bus, pki: Path, seconds: float, topics: Sequence[Topic]) -> None:
    """Compare a node's days and its state without the fuzzer and with it."""
    print("FUZZ_SEED", SEED)  # noqa: T201  # to run a failure again
    wrong = {
        name: [topic.key for topic in topics if SENDS.isdisjoint(may(role, topic))]
        for name, role in CERTIFICATES.items()
    }
    wrong = {name: topics for name, topics in wrong.items() if topics}
    path, nothing = folder / "run.mcap", folder / "nothing"
    nothing.mkdir()
    with zenostat.connect(node.endpoint, keys=pki, role=Role.OPERATOR, affinity="off") as operator:
        link = prepare(bus, operator)
        bus.record("office", path, now=True)
        alone = day(link)
        assert day(link) == alone
        before, children = state(bus, pki), psutil.Process(node.pid).children(recursive=True)
        settings = {"endpoint": node.endpoint, "keys": str(pki), "node": "office", "folder": str(nothing)}
        with RoleFuzzer(wrong, **settings, seed=SEED, victim=link.name) as fuzzer:
            warm, until_s = None, time.monotonic() + seconds
            while warm is None or time.monotonic() < until_s:
                fuzzer.begin_round()
                assert day(link) == alone
                fuzzer.end_round()
                warm = warm or size_of(node.pid)
            assert day(link) == alone
            assert state(bus, pki) == before
            assert psutil.Process(node.pid).children(recursive=True) == children, "nothing was started"
            assert size_of(node.pid)[2] < warm[2] + 50
            until(lambda: size_of(node.pid)[0] <= warm[0] + 5, "descriptors are given back")
            until(lambda: size_of(node.pid)[1] <= warm[1] + 3, "threads have ended")
            assert set(fuzzer.sent) == {key for keys_ in wrong.values() for key in keys_}
        bus.stop_recording("office")
        link.close()
    _, alone, *fuzzed, _ = recorded_days(path)  # a recording begins and ends within a day
    assert len(alone) > 97
    for recorded in fuzzed:
        assert recorded == alone, "nothing else was recorded"
    assert list(nothing.iterdir()) == [], "nothing was executed or written"


@pytest.mark.slow
def test_permissions__fuzzed_topics_of_other_roles_change_nothing(
    folder: Path, node: NodeProgram, bus: Bus, pki: Path
) -> None:
    fuzz(folder, node, bus, pki, QUICK_S, TOPICS)


@pytest.mark.slow
@pytest.mark.timeout(300 + 4 * max(ALL_S, TOPIC_S))
@pytest.mark.parametrize(("seconds", "topics"), LONG)
def test_permissions__a_minute_of_fuzzing_changes_nothing(
    folder: Path, node: NodeProgram, bus: Bus, pki: Path, seconds: float, topics: Sequence[Topic]
) -> None:
    fuzz(folder, node, bus, pki, seconds, topics)


@pytest.mark.slow
def test_permissions__fuzzer_of_the_right_roles_has_effects(folder: Path, scratch: Path, pki: Path) -> None:
    """Certificates of the right roles: the fuzzer's messages do reach a node, and have effects."""
    sent = [t.key for t in TOPICS if t.has_sender and t.delivery is not Delivery.TOKEN and t not in (STOP, REVOKE)]
    listen = [f"tls/127.0.0.1:{free_port()}"]
    settings = {"endpoint": listen[0], "keys": str(pki), "node": "office", "folder": str(folder), "victim": "second"}
    with (
        NodeProgram(scratch / "own", plant=PLANT, listen=listen, keys=str(pki)) as own,
        zenostat.connect(own.endpoint, keys=pki, role=Role.MONITOR, affinity="off") as watcher,
        RoleFuzzer({"trainer": sent}, **settings, seed=SEED) as fuzzer,
    ):

        def has_effects() -> bool:
            fuzzer.begin_round()
            fuzzer.end_round()
            status = watcher.status("office")
            return status.rejected > 0 and status.episode[0] > 0

        until(has_effects, "messages are rejected, and an episode has begun")
