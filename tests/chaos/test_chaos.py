"""The chaos run holds; and what judges it sees what is wrong, on records made by hand."""

import itertools
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.run_cli import run_python

from chaos.account import Account, Episode
from chaos.controller import LOST
from chaos.crew import environment
from chaos.disturbances import Disturbance, script
from chaos.invariants import _contiguous, _flat
from chaos.journal import Sent
from chaos.report import BEGIN, END
from chaos.run import Outcome, Resources
from zenostat.topics.messages import Actuator, Event, EventKind, Flag, Manifest, Mode, Policy, Sample, Versions

PAGE = Path(__file__).parents[2] / "docs" / "reliability.md"


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.variants
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("seconds", "seed"), [(10, 2026), (45, 6), (120, 6)])
def test_chaos__run_with_this_seed_holds(seconds: int, seed: int, scratch: Path) -> None:
    """On a failure, the seed and what broke stand in the output."""
    words = ["-P", "-m", "chaos", "--seconds", str(seconds), "--seed", str(seed)]
    done = run_python(*words, env=environment(), timeout=580)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"seed {seed}" in done.stdout
    assert "broken" not in done.stdout
    assert seconds < 45 or not re.search(r"│ +0 │", done.stdout), "every disturbance occurs"


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_chaos__recordings_of_killed_nodes_verify_up_to_their_ends(scratch: Path) -> None:
    done = run_python("-P", "-m", "chaos.recordings", "--seconds", "20", "--seed", "3", env=environment(), timeout=380)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"[1-9]\d* nodes were killed; [1-9][\d,]* steps", done.stdout)


@pytest.mark.parametrize(
    ("seconds", "grown_mb", "flat"),
    [(900.0, 64.0, False), (900.0, 6.0, True), (180.0, 64.0, False), (180.0, 10.0, True)],
)
def test_chaos__memory_that_grows_all_the_time_is_seen(
    seconds: float, grown_mb: float, flat: bool, tmp_path: Path
) -> None:
    """A node that reads messages of 8 MB now and then, and grows steadily."""
    held = []
    for second in range(int(seconds)):
        read = 24e6 if second > 0.9 * seconds and second % 10 == 0 else 0.0
        node_bytes = int(100e6 + grown_mb * 1e6 * second / seconds + read)
        held.append(Resources(second, node_bytes, 200_000_000, descriptors=40, threads=17))
    faults = _flat(Outcome(tmp_path, 1, seconds=seconds, resources=held))
    assert [fault.partition(" grew")[0] for fault in faults] == ([] if flat else ["the node's resident bytes"])


def test_chaos__one_seed_is_one_script_that_has_every_disturbance() -> None:
    one, again, other = (list(itertools.islice(script(seed, 120.0), 200)) for seed in (6, 6, 7))
    assert one == again
    assert one != other
    assert {step.disturbance for step in one[:29]} == set(Disturbance)
    assert all(step.pause_s >= 0 and 0 <= step.draw < 1 and 0 <= step.amount < 1 for step in one)


def test_chaos__short_run_has_no_freeze_that_outlasts_it() -> None:
    assert Disturbance.FREEZE_LONG not in {step.disturbance for step in itertools.islice(script(6, 20.0), 200)}


def test_chaos__page_has_a_row_for_every_disturbance_and_lost_nothing() -> None:
    table = PAGE.read_text().partition(BEGIN)[2].partition(END)[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line[:2] == "| "]
    assert [row[0] for row in rows[1:]] == [str(disturbance) for disturbance in Disturbance]
    assert all(int(row[1].replace(",", "")) > 0 for row in rows[1:])
    assert {row[2] for row in rows[1:]} == {"nothing"}


# Samples are contiguous


def sample(
    step: int, *, episode: int = 0, last: int = 3, value_source: str = "", rows: str = "", flags: int = 0
) -> Sample:
    """Two actuators, `a` and `b`: `ruled` names their rulers, `rows` their values, both with a blank between."""
    sources, values = value_source.split() or ["-", "-"], rows.split() or ["21", "21"]
    names = ["", *dict.fromkeys(name for name in sources if name != "-")]
    return Sample(
        episode=[episode],
        step=[step],
        time=[""],
        elapsed_s=[0.0],
        flags=[flags | (Flag.FIRST if step == 0 else Flag.TRUNCATED if step == last else 0)],
        values=b"",
        effective=np.array([float(value) for value in values]).tobytes(),
        source_index=np.array([0 if name == "-" else names.index(name) for name in sources], "<u2").tobytes(),
        sources=names,
    )


WHOLE = Episode(0, [sample(step) for step in range(4)])
STOPPED = Episode(1, [sample(step, episode=1) for step in range(2)])


def test_chaos__whole_and_stopped_episodes_are_contiguous() -> None:
    assert _contiguous([WHOLE, STOPPED, replace(STOPPED, number=2)], steps=3) == []


@pytest.mark.parametrize(
    "episodes",
    [
        [],
        [WHOLE, replace(STOPPED, number=2)],
        [replace(WHOLE, samples=WHOLE.samples[1:])],
        [replace(WHOLE, samples=[*WHOLE.samples[:2], WHOLE.samples[3]])],
        [replace(WHOLE, samples=[*WHOLE.samples[:2], *WHOLE.samples[1:]])],
        [replace(WHOLE, samples=[*WHOLE.samples[:3], sample(3, last=9)])],
        [replace(WHOLE, samples=[*WHOLE.samples[:2], sample(2, last=2)])],
    ],
    ids=["none", "an episode", "the first", "a gap", "twice", "no end", "an early end"],
)
def test_chaos__what_is_missing_or_there_twice_is_seen(episodes: list[Episode]) -> None:
    assert _contiguous(episodes, steps=3)


# Each applied command belongs to the step that it answered

MANIFEST = Manifest(
    node="n",
    instance="i",
    building="b",
    weather="w",
    location="l",
    begin="",
    end="",
    step_s=900.0,
    steps=3,
    mode=Mode.LOCKSTEP,
    policy=Policy.HOLD,
    sensors=(),
    meters=(),
    actuators=tuple(Actuator(name=n, component_type="", control_type="", key="", unit="C") for n in "ab"),
    versions=Versions(zenostat="", energyplus=""),
)


def command(name: str, step: int, a: float | None, b: float | None = None, *, only_a: bool = False) -> Sent:
    return Sent(name, 0, step, 1, {0: a} if only_a else {0: a, 1: b})


def event(kind: EventKind, text: str = "", source: str = "") -> Event:
    return Event(kind=kind, text=text, source=source)


BASE, NORTH = "base-1-0", "north-2-0"
JOINED = [event(EventKind.CONNECTED, f"{name} controls at priority 1", name) for name in (BASE, NORTH)]
STARTED = event(EventKind.STARTED)
COMMANDS = [
    command(BASE, 0, 20, 21),
    command(BASE, 1, 22, 23),
    command(BASE, 2, 24, 25),
    command(NORTH, 0, 30, only_a=True),
    command(NORTH, 1, 31, only_a=True),
    command(NORTH, 2, None, only_a=True),
]
BOTH = f"{NORTH} {BASE}"


def account(*stream: Event | Sample, commands: list[Sent] = COMMANDS) -> Account:
    by_role = {role: [one for one in commands if one.name.startswith(role)] for role in ("north", "base")}
    kept = Account(MANIFEST, by_role, by_role)
    for message in (*JOINED, STARTED, sample(0), *stream):
        kept.see(message) if isinstance(message, Sample) else kept.hear(message)
    return kept


def test_chaos__day_in_lockstep() -> None:
    kept = account(
        sample(1, value_source=BOTH, rows="30 21"),
        sample(2, value_source=BOTH, rows="31 23"),
        sample(3, value_source=f"{BASE} {BASE}", rows="24 25"),
    )
    assert kept.faults == []
    assert kept.episodes[0].rulings == [[30, 21], [31, 23], [24, 25]]


@pytest.mark.parametrize(
    "wrong",
    [
        sample(1, value_source=BOTH, rows="31 21"),
        sample(1, value_source=BOTH, rows="30 21.000000000000004"),
        sample(1, value_source=f"{BASE} {BASE}", rows="20 21"),
        sample(1, value_source=f"{NORTH} -", rows="30 21"),
        sample(1, value_source=f"{NORTH} nobody", rows="30 21"),
    ],
    ids=["of another step", "the last bit", "passed over", "not applied", "somebody else"],
)
def test_chaos__wrong_command_is_seen(wrong: Sample) -> None:
    assert account(wrong).faults


def test_chaos__timestep_without_a_command_must_state_so() -> None:
    only_first = [one for one in COMMANDS if one.step == 0 or one.name == BASE]
    first, held = sample(1, value_source=BOTH, rows="30 21"), {"value_source": BOTH, "rows": "30 23"}
    assert account(first, sample(2, **held), commands=only_first).faults
    assert account(first, sample(2, **held, flags=Flag.FALLBACK), commands=only_first).faults == []
    assert account(first, sample(2, value_source=f"{BASE} {BASE}", rows="22 23", flags=2), commands=only_first).faults


def test_chaos__what_came_too_late_may_rule_no_other_step() -> None:
    """north's command 1 was late; held is its command 0, and then its command 2 releases."""
    late = [sample(1, value_source=BOTH, rows="30 21"), sample(2, value_source=BOTH, rows="30 23", flags=Flag.FALLBACK)]
    assert account(*late, sample(3, value_source=f"{BASE} {BASE}", rows="24 25")).faults == []
    assert account(*late, sample(3, value_source=BOTH, rows="31 25")).faults


def test_chaos__another_takes_over_and_what_was_commanded_holds_until_it_commands() -> None:
    second = "north-3-0"
    stream: list[Event | Sample] = [
        sample(1, value_source=BOTH, rows="30 21"),
        event(EventKind.DISCONNECTED, "gone", NORTH),
        event(EventKind.CONNECTED, f"{second} controls at priority 1", second),
        sample(2, value_source=f"{second} {BASE}", rows="33 23"),
    ]
    mine = [one for one in COMMANDS if (one.name, one.step) != (NORTH, 1)]
    assert account(*stream, commands=[*mine, command(second, 1, 33, only_a=True)]).faults == []
    assert account(*stream, commands=mine).faults


def test_chaos__person_rules_until_the_time_is_over() -> None:
    person = f"person {BASE}"
    write = event(EventKind.WRITTEN, "a = 26.5 C at priority 8", "person")
    over = event(EventKind.EXPIRED, "a relinquished at priority 8", "person")
    override = sample(1, value_source=person, rows="26.5 21")
    assert account(write, override, over, sample(2, value_source=BOTH, rows="31 23")).faults == []
    assert account(write, sample(1, value_source=BOTH, rows="30 21")).faults
    assert account(override).faults
    assert account(write, override, over, sample(2, value_source=person, rows="26.5 23")).faults


def test_chaos__nothing_of_an_episode_controls_the_next() -> None:
    def after(next_one: Callable[[], Sample]) -> list[str]:
        return account(
            sample(1, value_source=BOTH, rows="30 21"),
            event(EventKind.DISCONNECTED, "gone", NORTH),
            Event(kind=EventKind.STARTED, text="", episode=1),
            sample(0, episode=1),
            next_one(),
            commands=[*COMMANDS, replace(command(BASE, 0, 20, 21), episode=1)],
        ).faults

    assert after(lambda: sample(1, episode=1, value_source=f"{BASE} {BASE}", rows="20 21")) == []
    assert after(lambda: sample(1, episode=1, value_source=BOTH, rows="30 21"))


@pytest.mark.slow
def test_chaos__controller_that_leaves_is_not_ended_by_the_signal_to_repeat(tmp_path: Path) -> None:
    """The signal comes again and again, also while the interpreter ends."""
    settings = {"endpoint": f"unixsock-stream/{tmp_path}/none", "journal": str(tmp_path / "journal")}
    previous = signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # inherited, as in a run
    try:
        command = [sys.executable, "-P", "-m", "chaos.controller", json.dumps(settings)]
        process = subprocess.Popen(command, env=environment(), stderr=subprocess.DEVNULL)
    finally:
        signal.signal(signal.SIGUSR1, previous)
    while process.poll() is None:
        process.send_signal(signal.SIGUSR1)
    assert process.returncode == LOST
