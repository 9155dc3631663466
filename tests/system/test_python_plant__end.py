"""The end of plants of a user's: in a timestep that never ends, with processes of their own, and by `close()`."""

import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import psutil
import pytest
from support.nodes import NodeProgram, hosts_of, node_on_bus, runs, until
from zenoh.handlers import Callback

import zenostat
from zenostat import ControllerLink
from zenostat.topics import codec, keys
from zenostat.topics.errors import EngineDied
from zenostat.topics.messages import Ack, CreateBranch, ErrorReply, Message, Reset, State, Stop, TakeSnapshot

pytestmark = pytest.mark.usefixtures("scratch")

PLANT = """
import os, signal, subprocess, sys
from pathlib import Path

FOLDER = Path(__file__).parent

class Plant:
    step_s, duration_s = 60.0, 3600.0
    sensors, actuators = {"level": "m"}, {"loops": ("1", 0.0, 1.0, 0.0)}
    child = ""

    def __init__(self):
        self.child = subprocess.Popen([sys.executable, "-c", "import signal; print(0, flush=True); " + self.program],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, **self.options)
        self.child.stdout.readline()
        (FOLDER / f"child-{self.child.pid}").touch()

    program, options = "signal.pause()", {}

    def reset(self, seed):
        self.loop(seed == 13)
        return {"level": 0.0}

    def step(self, commands):
        self.loop(commands["loops"] > 0.5)
        return {"level": 1.0}

    def loop(self, forever):
        while forever:
            pass

class Closing(Plant):
    def close(self):
        self.child.kill()
        self.child.wait()
        (FOLDER / f"closed-{os.getpid()}").touch()

class Saving(Closing):
    def save(self):
        return 0

    def restore(self, state):
        pass

class Forking(Closing):
    forkable = True

class Endless(Plant):
    def close(self):
        self.loop("describe" not in sys.argv)

class Stubborn(Plant):
    program = "[signal.signal(n, signal.SIG_IGN) for n in (signal.SIGHUP, signal.SIGTERM)]; signal.pause()"
"""


@contextmanager
def controlled(folder: Path, name: str, **settings: Any) -> Iterator[tuple[NodeProgram, zenostat.Bus, ControllerLink]]:
    (folder / "plant.py").write_text(PLANT)
    with (
        node_on_bus(folder / "node", plant=f"{folder}/plant.py:{name}", **settings) as (node, bus),
        bus.controller("office") as link,
    ):
        try:
            yield node, bus, link
        finally:
            if node.process.poll() is None:
                bus.stop("office")


def children(folder: Path) -> list[psutil.Process]:
    """All processes that instances have started and that run."""
    processes = []
    for path in folder.glob("child-*"):
        with suppress(psutil.NoSuchProcess):
            processes.append(psutil.Process(int(path.name.partition("-")[2])))
    return [process for process in processes if runs(process)]


def instances(folder: Path, event: str) -> int:
    return len([*folder.glob(f"{event}-*")])


def request(bus: zenostat.Bus, topic: keys.Topic, message: Message) -> SimpleQueue[Any]:
    """Send a request and do not wait for its reply."""
    replies: SimpleQueue[Any] = SimpleQueue()
    bus.session.get(
        topic.at("office", sender=getattr(message, "controller", "") or "panel"),
        Callback(replies.put, lambda: replies.put(None), indirect=False),
        payload=codec.encode(message),
    )
    return replies


def in_endless_step(bus: zenostat.Bus, link: ControllerLink) -> None:
    link.reset()
    link.send({"loops": 1.0})
    until(lambda: bus.status("office").state is State.RUNNING, "the timestep begins")


@pytest.mark.slow
def test_python_plant__stop_while_requests_wait_behind_a_timestep_answers_all_of_them(
    scratch: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with controlled(scratch, "Plant", unresponsive_s=1e6) as (node, bus, link):
        in_endless_step(bus, link)
        waiting = [
            request(bus, keys.RESET, Reset()),
            request(bus, keys.BRANCH, CreateBranch(controller=link.name)),
            request(bus, keys.RESET, Reset(slots=[0])),
        ]
        bus.status("office")  # answered at once, after they were received
        stop = request(bus, keys.STOP, Stop())
        assert node.process.wait(60) == 0
        assert codec.decode(Ack, stop.get(timeout=60).ok.payload.to_bytes())
        for replies in waiting:
            reply = replies.get(timeout=60).ok
            assert str(reply.encoding) == codec.encoding(ErrorReply)
            error = codec.decode(ErrorReply, reply.payload.to_bytes())
            assert (error.error, error.message) == ("NodeLost", "node 'office' is ending")
    until(lambda: not children(scratch), "nothing is left")
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("where", ["step", "reset"])
def test_python_plant__reset_gives_up_a_timestep_or_a_start_that_never_ends(scratch: Path, where: str) -> None:
    with controlled(scratch, "Plant", unresponsive_s=1.0) as (node, bus, link):
        if where == "step":
            in_endless_step(bus, link)
        else:
            bus.reset("office", Reset(seed=13))
        looping = hosts_of(node.pid)
        assert link.reset(seed=1).step == 0
        link.send({"loops": 0.0})
        assert link.receive()["level"] == 1.0
        assert not any(map(runs, looping))
        assert len(children(scratch)) == 1, "those of the process that was given up have ended with it"


@pytest.mark.slow
def test_python_plant__error_states_that_a_reset_gave_the_timestep_up(scratch: Path) -> None:
    with controlled(scratch, "Plant", unresponsive_s=1.0) as (_, bus, link):
        in_endless_step(bus, link)
        bus.reset("office", Reset())
        with pytest.raises(EngineDied, match="a reset had waited for 1 s for the end of its timestep"):
            link.receive()


COPIED = """
class Plant:
    step_s, duration_s = 60.0, 3600.0
    sensors, actuators = {"level": "m"}, {"valve": "1"}

    def reset(self, seed):
        return {"level": 0.0}

    def step(self, commands):
        return {"level": 1.0}

    def save(self):
        return None

    def restore(self, state):
        while True:
            pass
"""


@pytest.mark.parametrize("topic", [keys.BRANCH, keys.SNAPSHOT], ids=lambda topic: topic.key.rpartition("/")[2])
def test_python_plant__reset_gives_up_a_copy_that_is_being_created(scratch: Path, topic: keys.Topic) -> None:
    (scratch / "plant.py").write_text(COPIED)
    settings = {"plant": f"{scratch / 'plant.py'}:Plant", "unresponsive_s": 1.0}
    with node_on_bus(scratch / "node", **settings) as (node, bus), bus.controller("office") as link:
        link.reset()
        kept = hosts_of(node.pid)
        kind = CreateBranch if topic is keys.BRANCH else TakeSnapshot
        replies = request(bus, topic, kind(controller=link.name))
        until(lambda: len(hosts_of(node.pid)) > len(kept), "a process for the copy starts")
        assert link.reset(seed=1).step == 0
        error = codec.decode(ErrorReply, replies.get(timeout=60).ok.payload.to_bytes())
        assert error.error == "EngineDied"
        assert "a reset had waited for 1 s for the end of a copy" in error.message
        assert hosts_of(node.pid) == kept
        link.send()
        assert link.receive()["level"] == 1.0


ENDS = {
    "stop": lambda node, bus: bus.stop("office"),
    "SIGTERM": lambda node, _: os.kill(node.pid, signal.SIGTERM),
    "SIGKILL": lambda node, _: os.kill(node.pid, signal.SIGKILL),
}


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", ["Plant", "Closing"])
def test_python_plant__what_a_class_has_started_ends_with_the_node(folder: Path, name: str, end: str) -> None:
    with controlled(folder, name, slots=2, baseline=True) as (node, bus, link):
        link.reset()
        assert len(children(folder)) == 4
        assert instances(folder, "child") == 5, "and one that described the class"
        ENDS[end](node, bus)
        node.process.wait(60)
        until(lambda: not children(folder), "the children have ended")
        shutil.rmtree(node.folder)  # which a node that is killed leaves
        closed = {"Plant": 0, "Closing": 1 if end == "SIGKILL" else 5}[name]
        assert instances(folder, "closed") == closed


def test_python_plant__children_end_with_a_killed_node_that_nohup_started(folder: Path) -> None:
    previous = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with controlled(folder, "Plant") as (node, _, link):
            link.reset()
            assert len(children(folder)) == 1
            node.process.kill()
            node.process.wait(60)
            until(lambda: not children(folder), "the children have ended")
            shutil.rmtree(node.folder)  # which a node that is killed leaves
    finally:
        signal.signal(signal.SIGHUP, previous)


@pytest.mark.slow
def test_python_plant__child_that_ignores_signals_ends_with_the_node(folder: Path) -> None:
    with controlled(folder, "Stubborn") as (node, bus, link):
        link.reset()
        assert len(children(folder)) == 1
        bus.stop("office")
        assert node.process.wait(60) == 0
        assert not children(folder)


@pytest.mark.slow
def test_python_plant__close_that_never_ends_does_not_keep_the_node(scratch: Path) -> None:
    with controlled(scratch, "Endless", slots=3) as (node, bus, link):
        link.reset()
        bus.stop("office")
        assert node.process.wait(60) == 0
        assert not children(scratch)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "closed"), [("Saving", 1), ("Forking", 0)])
def test_python_plant__copy_is_closed_unless_it_is_a_fork(scratch: Path, name: str, closed: int) -> None:
    with controlled(scratch, name) as (_, bus, link):
        link.reset()
        before = instances(scratch, "closed")
        snapshot = bus.snapshot("office", link.name).snapshot
        assert instances(scratch, "closed") == before
        bus.drop("office", snapshot)
        assert instances(scratch, "closed") == before + closed
        link.send({"loops": 0.0})
        assert link.receive().step == 1
