"""A program that sends everything it can think of on topics that the roles of its certificates may not use.

It is a client of Zenoh, which sends what nobody has asked for as well: only the node's access rules stop it. It reads a
JSON object from standard input; each further line has it send another round, and it prints the number of messages of
each topic so far.
"""

import json
import pickle
import random
import sys
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgpack
import zenoh
from zenoh.handlers import Callback

from zenostat.bridge.transport.session import open_session
from zenostat.topics import keys
from zenostat.topics.keys import TOPICS, Delivery, Topic

ROUND = 200
POINTS = ("zone_1_cooling_setpoint", "zone_1_heating_setpoint", "zone_1_air_temperature", "one")
SUFFIXES = ("", "", "", "", "", "/x", "/*", "/**", "/../x", ".x", "/é", "/@x", "/$*", "?a=1", "#x", "/" + "y" * 3000)
ENCODINGS = ("", "application/msgpack", "application/msgpack;zenostat/3.Command", "zenoh/bytes", "application/yaml")


class Executed:
    """A pickle of it creates a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


class Fuzzer:
    """Draws keys and payloads of topics.

    Args:
        draw: of random numbers.
        own: the name in the certificate.
        node: the node's name.
        folder: in which nothing may be created.
        victim: the name of a controller with a claim.
    """

    def __init__(self, draw: random.Random, own: str, node: str, folder: Path, victim: str) -> None:
        self._draw, self._own, self._node, self._folder, self._victim = draw, own, node, folder, victim
        self._canary = folder / "executed"

    def key(self, topic: Topic) -> str:
        """Return a key of a topic, mostly one that a permitted sender would use, else one that resembles it."""
        draw = self._draw
        senders = (self._own, f"{self._own}.x", self._victim, "operator", "node", "*", "$*", "**", "-", "a" * 500)
        node = draw.choice((self._node, self._node, self._node, "*", "**", f"{self._node}$*", "ghost"))
        sender = draw.choice((self._own, self._victim, draw.choice(senders)))
        return topic.at(node, name=draw.choice((*POINTS, "*")), sender=sender) + draw.choice(SUFFIXES)

    def payload(self, topic: Topic) -> bytes:
        """Return a payload: one that would have an effect, the same one damaged, or anything."""
        draw = self._draw
        kind = draw.randrange(8)
        if kind < 4:
            valid = msgpack.packb(self._valid(topic.message.__name__ if topic.message else ""))
            return valid if kind < 3 else self._damaged(valid)
        if kind == 4:
            return draw.randbytes(draw.choice((0, 1, 100, 10_000)))
        if kind == 5:
            program = f"touch {self._canary}"
            return draw.choice(
                (
                    pickle.dumps(Executed(self._canary)),
                    f"!!python/object/apply:os.system ['{program}']".encode(),
                    f"__import__('os').system('{program}')".encode(),
                    f"$({program})`{program}`;{program}\n".encode(),
                    json.dumps({"plant": f"{self._canary}.py:Plant", "path": str(self._canary)}).encode(),
                )
            )
        if kind == 6:
            return b"\x91" * draw.randrange(20_000) + b"\xdd\xff\xff\xff\xff" * draw.randrange(5)
        return msgpack.packb({draw.choice(("value", "source", "controller", "path", "name")): self._anything()})

    def _valid(self, message: str) -> dict[str, Any]:
        draw = self._draw
        floats = b"\x00\x00\x00\x00\x00\x00\x3a\x40" * 6
        answers = {"episode": [draw.randrange(8)], "step": [draw.randrange(97)]}
        recording = str(self._folder / f"{draw.randrange(9)}.mcap")
        alarm = draw.choice(("hot", "cold"))
        valid: dict[str, dict[str, Any]] = {
            "Command": {**answers, "operations": None, "values": floats},
            "Write": {"value": draw.choice((None, 29.0)), "priority": draw.randrange(1, 17)},
            "Claim": {"controller": draw.choice((self._own, self._victim)), "priority": 1},
            "Reset": {"seed": draw.randrange(9)},
            "DropSnapshot": {"snapshot": f"s{draw.randrange(3)}"},
            "SimulatePlan": {"controller": self._victim, **answers, "timesteps": 2, "values": floats * 2},
            "TrySteps": {"alternatives": 2, "values": floats * 2},
            "SetPace": {"mode": draw.choice(("free", "paced")), "speed": 60.0},
            "StepRequest": {"steps": 3},
            "FaultPlan": {"faults": [{"kind": "bias", "points": "*", "offset": 5.0}]},
            "StartRecording": {"path": recording, "overwrite": True},
            "Acknowledge": {"alarm": alarm},
            "Shelve": {"alarm": alarm, "duration_s": 3600.0},
            "Unshelve": {"alarm": alarm},
            "RemoveFromService": {"alarm": alarm},
            "ReturnToService": {"alarm": alarm},
            "Revoke": {"name": draw.choice(("controller", "operator", self._victim))},
            "Event": {"kind": "stopped", "text": "forged"},
        }
        return valid.get(message, {})

    def _damaged(self, payload: bytes) -> bytes:
        damaged = bytearray(payload or b"\x80")
        for _ in range(self._draw.randrange(1, 4)):
            damaged[self._draw.randrange(len(damaged))] = self._draw.randrange(256)
        return bytes(damaged[: self._draw.randrange(1, len(damaged) + 1)])

    def _anything(self) -> Any:
        values: list[Any] = [
            None,
            True,
            -1,
            2**64 - 1,
            float("nan"),
            float("inf"),
            "x" * 500,
            "\x1b]0;x\x07",
            b"\xff",
            [[[]]],
        ]
        return self._draw.choice([*values, {"a": {}}, msgpack.ExtType(1, b"x")])


def send(session: zenoh.Session, fuzzer: Fuzzer, topic: Topic, draw: random.Random, declared: list[Any]) -> None:
    """Send one message, query or declaration on a topic; `ZError` if Zenoh itself refuses the key."""
    key, payload, encoding = fuzzer.key(topic), fuzzer.payload(topic), zenoh.Encoding(draw.choice(ENCODINGS))
    ignore: Callback[zenoh.Reply] = Callback(lambda _: None, indirect=False)
    if topic.delivery is Delivery.TOKEN:
        declared.append(session.liveliness().declare_token(key))
    elif draw.random() < 0.05:
        answer: Callback[zenoh.Query] = Callback(lambda query: query.reply(query.key_expr, payload), indirect=False)
        declared.append(session.declare_queryable(key, answer, complete=True))
    elif draw.random() < 0.05:
        session.delete(key)
    elif topic.delivery is Delivery.QUERY and draw.random() < 0.8:
        session.get(key, ignore, payload=payload, encoding=encoding, timeout=5)
    else:
        session.put(key, payload, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK)
    while len(declared) > 20:
        declared.pop(0).undeclare()


class Stranger:
    """A session with a certificate of the wrong role for all topics that it sends on."""

    def __init__(self, session: zenoh.Session, topics: list[Topic], fuzzer: Fuzzer, node: str) -> None:
        self._session, self._topics, self._fuzzer, self._node = session, topics, fuzzer, node
        self._declared: list[Any] = []

    def send_round(self, draw: random.Random, sent: Counter[str]) -> None:
        """Send a round, and count the messages of each topic."""
        for _ in range(ROUND):
            topic = draw.choice(self._topics)
            try:
                send(self._session, self._fuzzer, topic, draw, self._declared)
            except zenoh.ZError:
                continue  # not a key of Zenoh's
            sent[topic.key] += 1

    def is_answered(self) -> bool:
        """Return whether the node answers a query that each role may send.

        It is behind all others on the link, so that they have arrived by then.
        """
        return any(reply.ok for reply in self._session.get(keys.STATUS.at(self._node), timeout=60))


def main() -> None:
    """Send rounds until standard input ends."""
    settings = json.loads(sys.stdin.readline())
    draw, node, folder = random.Random(settings["seed"]), settings["node"], Path(settings["folder"])
    sent: Counter[str] = Counter()
    with ExitStack() as stack:
        strangers = []
        for name, wrong in settings["topics"].items():
            session = open_session(connect=[settings["endpoint"]], keys=Path(settings["keys"]), certificate=name)
            topics = [topic for topic in TOPICS if topic.key in wrong]
            fuzzer = Fuzzer(draw, name, node, folder, settings["victim"])
            strangers.append(Stranger(stack.enter_context(session), topics, fuzzer, node))
        print("ready", flush=True)  # noqa: T201
        while sys.stdin.readline():
            for stranger in strangers:
                stranger.send_round(draw, sent)
            answered = all(stranger.is_answered() for stranger in strangers)
            print(json.dumps({"sent": sent, "answered": answered}), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
