"""Recordings under chaos: that of the run, and `python -m chaos.recordings`, which kills recorded nodes at random."""

import argparse
import os
import random
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from rich.console import Console
from support.nodes import SMALL, NodeProgram

import zenostat
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics import codec
from zenostat.topics.errors import InvalidRecording, ZenostatError
from zenostat.topics.messages import Sample

_NOISE = {"weather_noise": {"dry_bulb_temperature": {"sigma": 3.0, "mu": 0.0, "tau_h": 5.0}}}
_NOTHING = "ends before its first message"
_LONGEST_S = 5.0
_EARLY_EVERY = 5
"""Of so many nodes, one is killed at a time that counts from the connection, while its first episode starts."""
_MOST_WITHOUT_A_STEP = 10
"""Nodes after which a run ends in which none has lived long enough to record a step."""


def recording_faults(path: Path, messages: Iterable[Any]) -> list[str]:
    """Return the faults of a recording: it must verify, and have all messages that a monitor received."""
    result = verify(path)
    faults = [] if result.passed else [str(result)]
    faults += [*result.skipped, *result.notes, *([result.end] if result.end else [])]
    with RecordingReader(path) as reader:
        samples = [codec.decode(Sample, item.payload) for item in reader.messages({"Sample"})]
        if not reader.end.is_complete:
            faults.append(f"the recording is not complete: {reader.end.text}")
    recorded = {(sample.episode[0], sample.step[0]): sample for sample in samples}
    if len(recorded) < len(samples):
        faults.append(f"{len(samples) - len(recorded)} samples are recorded twice")
    lost = [s for s in messages if isinstance(s, Sample) and recorded.get((s.episode[0], s.step[0])) != s]
    if lost:
        first = lost[0]
        faults.append(f"{len(lost)} samples were heard otherwise, first that of {first.episode}, {first.step}")
    return faults


@dataclass(slots=True)
class Killed:
    """Recordings of nodes that were killed: how many, with how many verified steps in how many episodes, and faults."""

    nodes: int = 0
    empty: int = 0
    steps: int = 0
    episodes: int = 0
    faults: list[str] | None = None


def kill_recorded_nodes(folder: Path, *, seconds: float, seed: int) -> Killed:
    """Kill one recorded node after the other at random times, and verify what each has recorded up to its end.

    A controller steps and resets each node at random, and the time to the kill counts from its first sample, however
    long the machine takes to get there; for every fifth node from the connection. A file must verify to the bit
    over all of its samples, or end before its first message, as that of a node that was killed while it started.
    """
    rng, killed, number = random.Random(seed), Killed(faults=[]), 0
    end_s = monotonic() + seconds
    assert killed.faults is not None
    while monotonic() < end_s or (not killed.steps and number < _MOST_WITHOUT_A_STEP):
        number += 1
        path = folder / f"{number}.mcap"
        settings = {
            **SMALL,
            **_NOISE,
            "weather": [SMALL["weather"]],
            "slots": rng.choice((1, 1, 2)),
            "baseline": rng.random() < 0.3,
        }
        node = NodeProgram(folder / f"node-{number}", **settings, record=str(path))
        try:
            with zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus:
                is_early = number % _EARLY_EVERY == 0
                _kill_in_time(node, bus, rng, killed.faults, is_early=is_early)
        finally:
            node.close()
        killed.nodes += 1
        faults = len(killed.faults)
        _judge(path, killed)
        if len(killed.faults) == faults:
            path.unlink(missing_ok=True)
    return killed


def _kill_in_time(
    node: NodeProgram, bus: zenostat.Bus, rng: random.Random, faults: list[str], *, is_early: bool
) -> None:
    """Trouble a node until it is killed; an error before that is a fault."""
    is_killed = threading.Event()

    def kill() -> None:
        is_killed.set()
        node.kill()

    moment = threading.Timer(rng.uniform(0.0, _LONGEST_S), kill)
    if is_early:
        moment.start()
    try:
        _trouble(bus, rng, on_first_sample=(lambda: None) if is_early else moment.start)
    except ZenostatError as error:
        if not is_killed.is_set():
            faults.append(f"{node.folder.name}: {type(error).__name__}: {error}")
    finally:
        if moment.ident is not None:
            moment.join()


def _trouble(bus: zenostat.Bus, rng: random.Random, *, on_first_sample: Callable[[], None]) -> None:
    """Step, write, pause a slot, take snapshots and reset until the node is gone."""
    values = np.random.default_rng(rng.randrange(2**32))
    with bus.controller("office", name="random") as link:
        actuators, slots = link.manifest.actuators, link.manifest.slots
        shape = (slots, len(actuators)) if slots > 1 else (len(actuators),)
        low, high = np.array([[a.low or 0.0, 1.0 if a.high is None else a.high] for a in actuators]).T
        sample, snapshot = link.reset(seed=rng.randrange(1000)), ""
        on_first_sample()
        while True:
            draw = rng.random()
            if sample.truncated or draw < 0.01:
                sample, snapshot = link.reset(seed=rng.randrange(1000)), ""
            elif draw < 0.02:
                if snapshot:
                    sample = link.reset(snapshot=snapshot)
                    bus.drop("office", snapshot)
                    snapshot = ""
                else:
                    snapshot = bus.snapshot("office", controller=link.name).snapshot
            elif draw < 0.05:
                bus.write("office", actuators[0].name, float(low[0]), priority=3, duration_s=1800.0, source="person")
            link.send(values.uniform(low, high, shape))
            sample = link.receive() if not sample.truncated else sample


def _judge(path: Path, killed: Killed) -> None:
    assert killed.faults is not None
    try:
        result = verify(path)
    except InvalidRecording as error:
        if _NOTHING in str(error):
            killed.empty += 1
        else:
            killed.faults.append(f"{path.name}: {error}")
        return
    if result.skipped or result.is_damaged or not (result.passed or not result.episodes):
        killed.faults.append(f"{path.name}: {result}; {'; '.join(result.skipped)}")
    killed.empty += not result.episodes
    killed.steps += result.steps
    killed.episodes += result.episodes


def main() -> int:
    """Kills, verifies, tells; the recordings of a run that breaks something are kept."""
    parser = argparse.ArgumentParser(prog="chaos.recordings", description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, help="of the script; drawn and printed if it is not given")
    asked = parser.parse_args()
    seed = random.SystemRandom().randrange(1_000_000) if asked.seed is None else asked.seed
    console = Console()
    console.print(f"recorded nodes killed for {asked.seconds:g} s with seed {seed}", highlight=False)
    where = tempfile.gettempdir()
    # The path of a unix socket has 108 bytes at most.
    folder = Path(tempfile.mkdtemp(prefix="chaos-", dir=where if len(where) < 60 else "/tmp")).resolve()
    os.environ["TMPDIR"], tempfile.tempdir = str(folder), None
    killed = kill_recorded_nodes(folder, seconds=asked.seconds, seed=seed)
    console.print(
        f"{killed.nodes} nodes were killed; {killed.steps:,} steps in {killed.episodes:,} episodes of their recordings "
        f"are identical to the bit, and {killed.empty} were killed before their first episode was written",
        highlight=False,
    )
    for fault in killed.faults or ():
        console.print(f"broken: {fault}; it is in {folder}", markup=False, soft_wrap=True, style="red")
    if not killed.faults:
        shutil.rmtree(folder)
    return 1 if killed.faults or not killed.steps else 0


if __name__ == "__main__":
    sys.exit(main())
