"""A stranger, as a program: it sends what should change nothing, and writes of single points, which may.

`python -m chaos.flooder SETTINGS`, JSON: endpoint, node, journal. Each line of its standard input, JSON, is a flood:
disturbance, count, seed, names (of controllers). It notes what it is about to send, and ends with its input.
"""

import json
import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import zenoh
from zenoh import CongestionControl

import zenostat
from chaos.disturbances import Disturbance
from chaos.journal import Journal
from zenostat.bridge.client.bus import Bus
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics import codec, keys
from zenostat.topics.messages import SCHEMA_VERSION, Claim, Command, ErrorReply, Manifest, Reset, Sample, Write

PERSONS = 12
"""Names of those who write; a few, since each sample tells the names of those that hold something."""

PERSON_LEVEL = 8

_WRONG_FIELDS: list[dict[str, Any]] = [{"extra": 1}, {"values": "text"}, {"episode": [-1]}, {"step": ["0"]}]


class Flooder:
    """Floods one node."""

    def __init__(self, bus: Bus, node: str, journal: Journal) -> None:
        self._bus, self._node, self._journal = bus, node, journal
        self._manifest: Manifest = bus.manifest(node)

    def flood(self, disturbance: Disturbance, count: int, seed: int, names: list[str]) -> None:
        """Sends `count` messages of a kind."""
        rng, at = random.Random(seed), self._bus.latest(self._node)
        makers: dict[Disturbance, Callable[[], tuple[str, bytes, str]]] = {
            Disturbance.GARBAGE: lambda: (self._source(rng, names), *self._garbage(rng, at)),
            Disturbance.UNKNOWN: lambda: (self._command_key(f"stranger-{rng.randrange(1000)}"),
                self._command(at, 0, 0), ""),
            Disturbance.STALE: lambda: (self._source(rng, names), self._command(at, 0, -rng.randint(1, at.step[0])),
                ""),
            Disturbance.FUTURE: lambda: (self._source(rng, names), self._future(rng, at), ""),
            Disturbance.OVERSIZED: lambda: (self._source(rng, names), bytes(codec.MAX_BYTES + 1), ""),
            Disturbance.WRITES: lambda: (*self._write(rng), ""),
            Disturbance.BAD_WRITES: lambda: (*self._bad_write(rng), ""),
        }  # fmt: skip
        if disturbance is Disturbance.STALE and at.step[0] == 0:
            disturbance = Disturbance.FUTURE
        if disturbance is Disturbance.BAD_REQUESTS:
            refused = sum(self._refused_request(rng) for _ in range(count))
            self._journal.note(disturbance=disturbance.name, count=count, refused=refused)
            return
        if disturbance is Disturbance.LARGE:
            self._journal.note(disturbance=disturbance.name, count=0)  # none of them is for the node
            for _ in range(count):
                self._bus.session.put(f"{keys.root(self._node)}/nothing", bytes(codec.MAX_BYTES))
            return
        messages = [makers[disturbance]() for _ in range(count)]
        writes = [
            (key, codec.decode(Write, raw).model_dump())
            for key, raw, _ in messages
            if disturbance is Disturbance.WRITES
        ]
        self._journal.note(
            disturbance=disturbance.name, count=count, writes=[(keys.last_chunk(key), write) for key, write in writes]
        )
        for key, payload, encoding in messages:
            how = zenoh.Encoding(encoding) if encoding else None
            self._bus.session.put(key, payload, encoding=how, congestion_control=CongestionControl.BLOCK)

    def _command_key(self, name: str) -> str:
        return keys.COMMAND.at(self._node, sender=name)

    def _source(self, rng: random.Random, names: list[str]) -> str:
        return self._command_key(rng.choice([*names, "nobody"]))

    def _values(self) -> bytes:
        return np.array([a.low for a in self._manifest.actuators], "<f8").tobytes()

    def _command(self, at: Sample, episodes: int, steps: int) -> bytes:
        return codec.pack(
            episode=[at.episode[0] + episodes], step=[at.step[0] + steps], operations=None, values=self._values()
        )

    def _future(self, rng: random.Random, at: Sample) -> bytes:
        """Beyond the episode's end, or beyond all episodes that this run can have."""
        return self._command(at, *rng.choice([(0, self._manifest.steps + 1), (100_000, 0)]))

    def _garbage(self, rng: random.Random, at: Sample) -> tuple[bytes, str]:
        good = self._command(at, 0, 0)
        fields = msgpack.unpackb(good)
        payload = rng.choice(
            [
                rng.randbytes(rng.randrange(200)),
                good[: rng.randrange(len(good))],
                b"\x91" * rng.randrange(1, 100_000),
                b"\xdd\xff\xff\xff\xff",
                *(codec.pack(**(fields | wrong)) for wrong in _WRONG_FIELDS),
                good,
            ]
        )
        return payload, codec.encoding(Command).replace(f"/{SCHEMA_VERSION}.", "/9.") if payload is good else ""

    def _write(self, rng: random.Random) -> tuple[str, bytes]:
        actuator = rng.choice(self._manifest.actuators)
        value = round(rng.uniform(actuator.low or 0.0, actuator.high or 1.0), 3)
        free = rng.random() < 0.3
        duration_s = None if free or rng.random() < 0.2 else float(rng.randrange(900, 14400))
        source = f"person-{rng.randrange(PERSONS)}"
        write = Write(value=None if free else value, duration_s=duration_s, priority=PERSON_LEVEL, source=source)
        return keys.ACTUATOR.at(self._node, name=actuator.name, sender=source), codec.encode(write)

    def _bad_write(self, rng: random.Random) -> tuple[str, bytes]:
        actuator = rng.choice(self._manifest.actuators)
        point, payload = rng.choice(
            [
                ("no_such_point", codec.encode(Write(value=20.0))),
                (actuator.name, codec.encode(Write(value=(actuator.high or 0.0) + 1e6))),
                (actuator.name, rng.randbytes(rng.randrange(100))),
                (actuator.name, codec.pack(value=20.0, priority=99)),
                (actuator.name, codec.pack(value=float("nan"))),
            ]
        )
        return keys.ACTUATOR.at(self._node, name=point, sender="flooder"), payload

    def _refused_request(self, rng: random.Random) -> int:
        """1 if the node refused a request that it should refuse, and said why."""
        whole = codec.encode(Claim(controller="thief", priority=10, actuators=["no_such_point"]))
        topic, payload = rng.choice(
            [
                (keys.CLAIM, whole),
                (keys.CLAIM, b""),
                (keys.CLAIM, rng.randbytes(50)),
                (keys.CLAIM, codec.pack(controller="a/b*c#d", priority=10)),
                (keys.RESET, codec.encode(Reset(slots=[7]))),
                (keys.RESET, codec.encode(Reset(snapshot="none-such"))),
                (keys.PACE, b"\x91" * 1000),
            ]
        )
        replies = list(self._bus.session.get(topic.at(self._node, sender="thief"), payload=payload, timeout=30.0))
        return sum(r.ok is not None and str(r.ok.encoding) == codec.encoding(ErrorReply) for r in replies)


def main() -> None:
    """Floods as it is told, line by line."""
    settings: dict[str, Any] = json.loads(sys.argv[1])
    with zenostat.connect(settings["endpoint"], affinity=Affinity.OFF) as bus:
        flooder = Flooder(bus, settings["node"], Journal(Path(settings["journal"])))
        for line in sys.stdin:
            order = json.loads(line)
            flooder.flood(Disturbance(order["disturbance"]), order["count"], order["seed"], order["names"])


if __name__ == "__main__":
    main()
