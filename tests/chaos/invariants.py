"""Invariants of a run, whatever was done to it: each returns its faults in words."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

from support.nodes import programs_of, remains, until

from chaos import journal
from chaos.account import Account, Episode
from chaos.disturbances import Disturbance
from chaos.recordings import recording_faults
from chaos.replay import differences
from chaos.run import LEVELS, Outcome
from zenostat.topics.messages import Event, EventKind, Flag, Sample

MAY_GROW_BYTES = ((600.0, 8e6), (120.0, 16e6), (0.0, 48e6))
"""By the least seconds of a run: how much more the end of a run may hold than the most of its first half. In a short
run the first command of 8 MB, held in copies, may come after that."""

MAY_GROW = 8
"""Descriptors and threads, likewise; a status that is being asked for has some."""

CHANGED_NOTHING = (
    Disturbance.GARBAGE, Disturbance.UNKNOWN, Disturbance.FUTURE, Disturbance.OVERSIZED, Disturbance.BAD_WRITES,
)  # fmt: skip
"""Floods of which every message is rejected or counted as flooded; stale ones are late."""

_REFUSALS = {EventKind.REJECTED: "rejected", EventKind.LATE: "late", EventKind.DUPLICATE: "duplicate"}


@dataclass(slots=True)
class Verdict:
    """Verdict on a run: faults by invariant, and figures."""

    outcome: Outcome
    faults: dict[str, list[str]]
    episodes: int
    samples: int
    answers: int
    fallbacks: int
    messages: int
    refused: int

    @property
    def holds(self) -> bool:
        """Whether all invariants hold."""
        return not any(self.faults.values())


def judge(outcome: Outcome) -> Verdict:
    """Judges a run by its journals; replays it."""
    assert outcome.manifest is not None
    sent = {role: journal.sent(outcome.journal(role)) for role in LEVELS}
    account, events = Account(outcome.manifest, LEVELS, sent), list[Event]()
    for message in journal.recorded(outcome.record):
        if isinstance(message, Sample):
            account.see(message)
        else:
            events.append(message)
            account.hear(message)
    # The monitor may have come in the midst of episode 0: what is judged begins with a first sample.
    known = [episode for episode in account.episodes if episode.samples or episode.failed]
    counted, messages, refused = _counts(outcome, sent, events)
    faults = {
        "the programs end as they should": outcome.faults + _lost(outcome),
        "samples are contiguous": _contiguous(known, outcome.manifest.steps),
        "each applied command belongs to the step that it answered": account.faults,
        "the trajectory is that of a quiet run, to the bit": differences(outcome.folder / "quiet", known),
        "the node's recording is complete, and verifies to the bit": recording_faults(
            outcome.recording, journal.recorded(outcome.record)
        ),
        "every refusal is counted and named": counted + _written(outcome, events),
        "memory is flat": _flat(outcome),
        "nothing is left": _left(outcome),
    }
    samples = sum(len(episode.samples) for episode in known)
    return Verdict(outcome, faults, len(known), samples, account.answers, account.fallbacks, messages, refused)


def _lost(outcome: Outcome) -> list[str]:
    """Only who was frozen for longer than the bus waits may take the node for gone."""
    frozen = outcome.done[Disturbance.FREEZE_LONG]
    return [f"{outcome.lost} took the node for gone, {frozen} were frozen"] if outcome.lost > frozen else []


def _contiguous(episodes: list[Episode], steps: int) -> list[str]:
    faults = [] if episodes else ["no episode was recorded"]
    numbers = [episode.number for episode in episodes]
    if numbers and numbers != [*range(numbers[0], numbers[0] + len(numbers))]:
        faults.append(f"episodes {numbers}")
    for episode in episodes:
        indices = [sample.step[0] for sample in episode.samples]
        if indices != [*range(len(indices))]:
            at = next(
                i for i, (one, other) in enumerate(zip(indices, [*range(len(indices))], strict=True)) if one != other
            )
            faults.append(f"episode {episode.number}: {indices[max(at - 2, 0) : at + 3]} about sample {at}")
        truncated = [bool(sample.flags[0] & Flag.TRUNCATED) for sample in episode.samples]
        if truncated != [step == steps for step in range(len(indices))]:
            faults.append(f"episode {episode.number}: {len(indices)} samples, its last of {steps} marked wrongly")
    return faults


def _counts(outcome: Outcome, sent: dict[str, list[journal.Sent]], events: list[Event]) -> tuple[list[str], int, int]:
    """Every message that was sent is counted once; those of which the fate is known, as what they are."""
    status, faults = outcome.status, []
    assert status is not None
    floods = Counter[str]()
    for line in journal.lines(outcome.floods):
        floods[line["disturbance"]] += line["count"]
        if line.get("refused", line["count"]) != line["count"] and line["disturbance"] == Disturbance.BAD_REQUESTS.name:
            faults.append(f"of {line['count']} bad requests {line['refused']} were refused")
    commands = [command for role in sent.values() for command in role]
    # A controller notes a command before it sends it; one that is ended in between, or as it sends, has sent less.
    doubtful = sum({command.name: command.times for command in commands}.values())
    messages = sum(command.times for command in commands) + sum(
        count for disturbance, count in floods.items() if disturbance != Disturbance.BAD_REQUESTS.name
    )
    rate_limited = status.statistics.rate_limited
    refused = status.rejected + status.late + status.duplicate + rate_limited
    written = sum(event.kind is EventKind.WRITTEN for event in events)
    counted = status.accepted + refused + written
    if not messages - doubtful <= counted <= messages:
        faults.append(f"{messages} messages were sent ({doubtful} perhaps not), {counted} are counted")
    bad = sum(floods[disturbance.name] for disturbance in CHANGED_NOTHING)
    if status.rejected + rate_limited < bad:
        faults.append(f"{bad} bad messages were sent, {status.rejected} rejected and {rate_limited} flooded")
    reported = Counter(event.kind for event in events if event.kind in _REFUSALS)
    for kind, name in _REFUSALS.items():
        dropped = rate_limited if kind is EventKind.REJECTED else 0  # which an event reports, too
        if reported[kind] > getattr(status, name) + dropped or (getattr(status, name) and not reported[kind]):
            faults.append(f"{getattr(status, name)} are {name}, and {reported[kind]} events tell of one")
    faults += [f"an event says nothing: {event}" for event in events if event.kind in _REFUSALS and not event.text]
    return faults, messages + floods[Disturbance.BAD_REQUESTS.name], refused + floods[Disturbance.BAD_REQUESTS.name]


def _written(outcome: Outcome, events: Iterable[Event]) -> list[str]:
    """Check that somebody sent each write that the node accepted."""
    sent = Counter[tuple[str, str]]()
    for line in journal.lines(outcome.floods):
        for point, write in line.get("writes", []):
            how = "relinquished" if write["value"] is None else f"= {write['value']:g}"
            sent[write["source"], f"{point} {how}"] += 1
    for event in events:
        if event.kind is EventKind.WRITTEN:
            words = event.text.split()
            what = words[:3] if words[1] == "=" else [words[0], "relinquished"]  # or there was nothing to release
            sent[event.source, " ".join(what)] -= 1
    return [f"{source} never wrote {what}" for (source, what), count in sent.items() if count < 0]


def _flat(outcome: Outcome) -> list[str]:
    held, faults = outcome.resources, []
    bound_bytes = next(grown for least_s, grown in MAY_GROW_BYTES if outcome.seconds >= least_s)
    half_s, end_s = outcome.seconds / 2, outcome.seconds * 3 / 4
    early, late = [h for h in held if h.at_s <= half_s], [h for h in held if h.at_s > end_s]
    if not early or not late:
        return ["too short a run to tell"]
    for what, name, bound in (
        ("the node's resident bytes", "node_bytes", bound_bytes),
        ("the engine's resident bytes", "engine_bytes", bound_bytes),
        ("the node's descriptors", "descriptors", MAY_GROW),
        ("the node's threads", "threads", MAY_GROW),
    ):
        # The median: a message of 8 MB that is being read is no growth.
        before, after = max(getattr(h, name) for h in early), median(getattr(h, name) for h in late)
        if after > before + bound:
            faults.append(f"{what} grew from {before:,} at most in the first half to {after:,.0f} in the last quarter")
    return faults


def _left(outcome: Outcome) -> list[str]:
    try:
        until(lambda: not programs_of(outcome.folder), "all programs have ended")
    except AssertionError:
        return [f"a program is left: {one}" for one in programs_of(outcome.folder)]
    scratch = [str(path) for path in outcome.folder.glob("*/run")]  # the nodes' own, named in their settings
    return [f"left: {path}" for path in (*remains(outcome.folder), *scratch)]
