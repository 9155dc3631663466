"""Bring a new node to the last complete timestep of a recording: what the ended node received is applied again.

The plant receives the recorded orders, and the rules of the exchange the recorded messages. Both have to agree: an
order that does not follow from the rules, or a sample that is not equal to the bit, is an error, and nothing starts.
Only the present episodes are simulated, from the last start of episodes in all slots.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import msgpack
from pydantic import ValidationError

from zenostat.bridge.node.plant import Plant, RepeatablePlant
from zenostat.bridge.node.repetition import Repetition
from zenostat.bridge.python_plant.shipped import PANDAPOWER, shipped_option
from zenostat.bridge.recording.checked_messages import decode
from zenostat.bridge.recording.complete_part import Written
from zenostat.bridge.recording.continuation import read_written
from zenostat.bridge.recording.file import changed_files, open_written, recorded_digests
from zenostat.bridge.recording.reader import RecordedItem, RecordingReader
from zenostat.topics import yaml12
from zenostat.topics.alarm_rules import AlarmRules
from zenostat.topics.codec import describe_validation_errors
from zenostat.topics.errors import InvalidRecording
from zenostat.topics.messages import Manifest, State
from zenostat.topics.recording import RecordedEpisode, RecordedSnapshot, RecordedState

if TYPE_CHECKING:
    from zenostat.bridge.node.server import NodeServer

_FIXED = ("node", "slots", "baseline", "policy", "grace_s", "deadline_s", "begin", "end", "step_s", "steps")
_PATHS = ("building", "weather")
"""Settings of a provenance that are there only if they are paths."""


class Resumption:
    """A recording with which a new node goes on; `start`, then `run`. The caller closes it.

    Args:
        path: of the recording.

    Attributes:
        manifest: of the node that ended.
        alarm_rules: its alarm rules; None without any.
        written: what is complete of the file.
        steps: number of timesteps that are simulated again.

    Raises:
        InvalidRecording: the file cannot be read, is damaged, another program is recording to it, or a node cannot go
            on with what it contains.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._began_s, self._uses = monotonic(), set[str]()
        self._descriptor: int | None = open_written(path)
        with ExitStack() as undo:
            undo.callback(os.close, self._descriptor)
            self.reader = undo.enter_context(RecordingReader(path))
            self.written: Written = read_written(path)
            self.reader.limit(self.written.offset)
            self._find_start()
            undo.pop_all()
        self.manifest = self.reader.manifest

    def close(self) -> None:
        """Close the file, unless a recorder has it; idempotent."""
        self.reader.close()
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def describe(self) -> str:
        """Return what the new node has done, for its event."""
        exchange, elapsed_s = self._server.exchange, monotonic() - self._began_s
        time = self._server.samples.time(exchange.step[0])
        dropped = self.written.dropped
        lost = f"; {dropped:,} bytes at its end were incomplete and are dropped" if dropped else ""
        return (
            f"goes on with {self.path} at step {exchange.step[0]} ({time:%Y-%m-%d %H:%M:%S}); "
            f"{self.steps} timesteps simulated again in {elapsed_s:.3g} s, equal to the bit{lost}"
        )

    def take_descriptor(self) -> int:
        """Return the file's descriptor, which the caller closes."""
        assert self._descriptor is not None
        descriptor, self._descriptor = self._descriptor, None
        return descriptor

    def _error(self, text: str) -> InvalidRecording:
        return InvalidRecording(f"cannot go on with {self.path}: {text}")

    # What is simulated again

    def _find_start(self) -> None:
        """Find the last start in all slots after which no snapshot from before it is used."""
        starts: list[tuple[RecordedState, RecordedEpisode]] = []
        samples: list[int] = []
        taken: dict[str, int] = {}
        state, valid = None, -1
        for item in self.reader.messages({"RecordedState", "RecordedEpisode", "RecordedSnapshot", "Sample"}):
            if item.schema == "Sample" and samples:
                samples[-1] += 1
            elif item.schema == "RecordedState":
                state = self._decode_state(item)
            elif item.schema == "RecordedSnapshot":
                taken[decode(self.reader, RecordedSnapshot, item).snapshot] = len(starts) - 1
            elif item.schema == "RecordedEpisode":
                record = decode(self.reader, RecordedEpisode, item)
                if record.snapshot:
                    self._uses.add(record.snapshot)
                    valid = min(valid, taken.get(record.snapshot, -1))
                elif state is not None:
                    starts.append((state, record))
                    samples.append(0)
                    valid, state = len(starts) - 1, None
        if valid < 0 or not samples[valid]:
            raise self._error(
                "it has no start of episodes in all slots, from which they could be simulated again; recordings of "
                "earlier releases have none with which a node can go on"
            )
        self._start, (self._state, self._first) = valid, starts[valid]
        self.steps = max(sum(samples[valid:]) - 1, 0)
        self._check_start()

    def _check_start(self) -> None:
        if not self._first.inputs:
            raise self._error("its plant cannot repeat an episode")
        try:
            rules = self._state.alarms
            self.alarm_rules = None if rules is None else AlarmRules.model_validate(rules)
        except ValidationError as error:
            raise self._error(f"its alarm rules: {describe_validation_errors(error)}") from None

    def _decode_state(self, item: RecordedItem) -> RecordedState:
        try:  # the claims of a large plant have more entries than messages on the bus may have
            return RecordedState.model_validate(msgpack.unpackb(item.payload))
        except ValidationError as error:
            raise self._error(f"it is damaged: {describe_validation_errors(error)}") from None

    # The plant

    def start(self, plant: Plant) -> None:
        """Start the plant at the first sample of the recorded episodes.

        Raises:
            InvalidRecording: it is not the recorded plant, or cannot repeat an episode.
            SimulatorError: it cannot be started.
        """
        self._check_provenance(plant)
        if not isinstance(plant, RepeatablePlant):
            raise self._error("its plant cannot repeat an episode")
        record = self._first
        plant.repeat_episode(record.slots, record.inputs, record.episode)
        plant.start(record.slots)

    def _check_provenance(self, plant: Plant) -> None:
        """Raise `InvalidRecording` if a plant is not the recorded one; its files may be in other folders."""
        present, recorded = plant.description.provenance, self.reader.provenance
        settings = recorded.get("settings")
        settings = settings if isinstance(settings, dict) else {}
        if present.kind != recorded.get("kind"):
            raise self._error(f"it recorded a plant of the kind {recorded.get('kind')!r}, not {present.kind!r}")
        paths = [name for name in _PATHS if name in settings and name in present.settings]
        scenarios = (self._scenario(text, paths) for text in (self.reader.scenario, plant.description.scenario))
        if len({repr(scenario) for scenario in scenarios}) > 1:
            raise self._error("the scenario is another one")
        ours, theirs = _without_paths(present.settings), _without_paths(settings)
        if ours != theirs:
            raise self._error(f"its settings are {theirs}, not {ours}")
        changes = changed_files(
            self.path,
            recorded_digests(recorded),
            present.files,
            exact=False,
            missing=lambda role: f"the {role} is missing",
        )
        if changes:
            raise self._error("; ".join(changes))

    def _scenario(self, text: str, paths: Sequence[str]) -> dict[str, Any]:
        """Return the fields of a scenario without those that are paths."""
        fields = yaml12.parse(text, "its scenario") if text else {}
        return {name: value for name, value in fields.items() if name not in paths}

    def check(self, manifest: Manifest) -> None:
        """Raise `InvalidRecording` if the new node's settings or points are not those of the ended one."""
        differing = [name for name in _FIXED if getattr(manifest, name) != getattr(self.manifest, name)]
        texts = [f"its {name} is {getattr(self.manifest, name)}, not {getattr(manifest, name)}" for name in differing]
        if manifest.names != self.manifest.names or manifest.actuators != self.manifest.actuators:
            texts.append("its points are not those of the plant")
        if texts:
            raise self._error("; ".join(texts))

    def agreed_rules(self, rules: AlarmRules | None) -> AlarmRules | None:
        """Return the recorded alarm rules; raise `InvalidRecording` if `rules` are others."""
        if rules is not None and rules != self.alarm_rules:
            raise self._error("the alarm rules are not the recorded ones")
        return self.alarm_rules

    # All messages again

    def run(self, server: NodeServer, folder: Path) -> None:
        """Bring a server, whose plant `start` has started, to the last complete timestep; nothing is published.

        Args:
            server: not on the bus yet.
            folder: for the files of snapshots; the caller removes it.

        Raises:
            InvalidRecording: an order or a sample differs, or the episode is not one with which a node can go on.
            SimulatorError: the plant failed.
        """
        self._server = server
        server.describe({"task": self.manifest.task})
        Repetition(server, folder, self._state, self._uses, self._error).run(self._following_start())
        if server.exchange.state is State.FAILED:
            raise self._error(
                f"its episode failed at step {server.exchange.step[0]}, and there is nothing to go on with"
            )
        if not server.latest_sample:
            raise self._error("it has no sample")

    def _following_start(self) -> Iterator[RecordedItem]:
        """Yield the items after the state with which the present episodes begin."""
        items, number = self.reader.messages(), -1
        for item in items:
            number += item.schema == "RecordedState"
            if number == self._start:
                yield from items


def _without_paths(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a provenance without the folders of the files, whose digests are compared."""
    compared = {name: value for name, value in settings.items() if name not in _PATHS}
    if isinstance(plant := compared.get("plant"), str):
        compared["plant"] = plant.rpartition("/")[2]
        arguments = compared.get("plant_arguments")
        file = arguments.get("file") if isinstance(arguments, dict) else None
        if shipped_option(plant) is not None and isinstance(file, str) and not file.startswith(PANDAPOWER):
            compared["plant_arguments"] = {**compared["plant_arguments"], "file": Path(file).name}
    return compared
