"""A second account of who ruled what: 16 levels kept again, from what was sent and from the node's events alone.

Where a sample says that a required controller gave no command, it cannot be known which of the others' commands were in
time; then all possibilities are followed, and those that the sample contradicts are given up. None left is a fault.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np

from chaos.flooder import PERSON_LEVEL
from chaos.journal import Sent
from zenostat.topics.messages import Event, EventKind, Flag, Manifest, Sample

Entry = tuple[float | None, str]
Row = tuple[Entry, ...]
Rows = tuple[Row, ...]
Ruling = list[float | None]

_FREE: Entry = (None, "")
_OWN = "the building"
_WRITTEN = re.compile(rf"(\S+) (?:= (\S+) .*|relinquished) ?at priority {PERSON_LEVEL}")


@dataclass(slots=True)
class Episode:
    """Recorded episode: its samples, and for each timestep what each actuator was commanded to."""

    number: int
    samples: list[Sample] = field(default_factory=list)
    rulings: list[Ruling] = field(default_factory=list)
    failed: bool = False


class Account:
    """Keeps the account; feed it the recorded stream.

    Args:
        manifest: of the node.
        roles: controllers' places, the one that goes before the others first.
        sent: of each place, what its controllers sent.
    """

    def __init__(self, manifest: Manifest, roles: Iterable[str], sent: Mapping[str, list[Sent]]) -> None:
        self.roles = [*roles]
        self.episodes: list[Episode] = []
        self.faults: list[str] = []
        self.answers = 0
        self.fallbacks = 0
        self._index = {actuator.name: i for i, actuator in enumerate(manifest.actuators)}
        self._none: Row = (_FREE,) * len(manifest.actuators)
        self._sent: dict[str, dict[tuple[int, int], list[Sent]]] = {}
        for role in self.roles:
            by_step = self._sent[role] = defaultdict(list)
            for command in sent[role]:
                by_step[command.episode, command.step].append(command)
        self._claims: dict[str, str] = {}
        self._gone: set[str] = set()
        self._clear()

    def _clear(self) -> None:
        self._persons = self._none
        self._possible: set[Rows] = {(self._none,) * len(self.roles)}
        self._claims = {role: name for role, name in self._claims.items() if name not in self._gone}
        self._lost = False

    def hear(self, event: Event) -> None:
        """An event of the node, in its place among the samples."""
        role = event.source.partition("-")[0]
        match event.kind:
            case EventKind.STARTED:
                self._clear()
                self.episodes.append(Episode(event.episode))
            case EventKind.FAILED if self.episodes:
                self.episodes[-1].failed = True
            case EventKind.CONNECTED if "controls" in event.text and role in self.roles:
                self._claims[role] = event.source
            case EventKind.DISCONNECTED:
                self._gone.add(event.source)
            case EventKind.WRITTEN | EventKind.EXPIRED:
                self._write(event)

    def _write(self, event: Event) -> None:
        if " had nothing to re" in event.text:
            return
        match = _WRITTEN.fullmatch(event.text)
        assert match, event.text
        entry = _FREE if match[2] is None else (float(match[2]), event.source)
        row, index = self._persons, self._index[match[1]]
        self._persons = (*row[:index], entry, *row[index + 1 :])

    def see(self, sample: Sample) -> None:
        """A sample: who ruled, and whether its values are those that were sent for the sample before."""
        if not self.episodes or self.episodes[-1].number != sample.episode[0]:
            self.faults.append(f"sample {sample.step} of episode {sample.episode} came with no episode begun")
            return
        episode = self.episodes[-1]
        episode.samples.append(sample)
        if sample.step[0] == 0 or self._lost:
            return
        fallback = bool(sample.flags[0] & Flag.FALLBACK)
        self.fallbacks += fallback
        self._advance(sample, sample.step[0] - 1, fallback=fallback)
        if not self._possible:
            self._lost = True
            return
        episode.rulings.append([value for value, _ in self._resolved(next(iter(self._possible)))])

    def _advance(self, sample: Sample, answered: int, *, fallback: bool) -> None:
        where = (sample.episode[0], answered)
        ways = [[*self._ways(role, self._sent[role].get(where, []), fallback=fallback)] for role in self.roles]
        for role, possible in zip(self.roles, ways, strict=True):
            if not possible:
                text = f"went on without a command of {self._claims[role]} for sample {answered}, and does not say so"
                self._fault(sample, text)
        tried = {
            tuple(_after(row, way) for row, way in zip(rows, chosen, strict=True))
            for rows in self._possible
            for chosen in product(*ways)
        }
        self._possible = {rows for rows in tried if not self._contradiction(sample, rows)}
        self.answers += sum(bool(way) for way in ways)
        if not self._possible and tried:
            self._fault(sample, min((self._contradiction(sample, rows) for rows in tried), key=len))

    def _ways(self, role: str, sent: list[Sent], *, fallback: bool) -> Iterator[tuple[Sent, ...]]:
        """Which of the commands for a step may have been taken, in order; the present claimant's surely was."""
        name = self._claims.get(role)
        for size in range(len(sent) + 1):
            for chosen in combinations(sent, size):
                if fallback or name is None or any(command.name == name for command in chosen):
                    yield chosen

    def _resolved(self, rows: Rows) -> list[Entry]:
        ordered = (self._persons, *rows)
        return [next((row[i] for row in ordered if row[i][0] is not None), _FREE) for i in range(len(self._none))]

    def _contradiction(self, sample: Sample, rows: Rows) -> str:
        sources, effective = (
            [sample.sources[i] for i in np.frombuffer(sample.source_index, "<u2")],
            np.frombuffer(sample.effective).tolist(),
        )
        wrong = []
        for name, index in self._index.items():
            value, source = self._resolved(rows)[index]
            if source != sources[index]:
                wrong.append(f"{name} is ruled by {sources[index] or _OWN!r}, {source or _OWN!r} expected")
            elif value is not None and value != effective[index]:
                wrong.append(f"{name} is {effective[index]!r}, and {source} sent {value!r}")
        return "; ".join(wrong)

    def _fault(self, sample: Sample, text: str) -> None:
        if len(self.faults) < 20:
            self.faults.append(f"episode {sample.episode[0]}, timestep {sample.step[0]}: {text}")


def _after(row: Row, commands: tuple[Sent, ...]) -> Row:
    entries = [*row]
    for command in commands:
        for index, value in command.values.items():
            entries[index] = _FREE if value is None else (value, command.name)
    return tuple(entries)
