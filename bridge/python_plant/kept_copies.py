"""Processes that are kept for trials of a class with `save` and `restore`: each trial restores a state in them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.engine.lists import close_all
from zenostat.topics.errors import EngineDied, ForkFailed, SimulatorError


class KeptCopies:
    """Copies of a plant's processes that wait for the next trial, with the state of the last one.

    A trial has as many of them as alternatives at the same time; a process that failed in one is not used again. All
    methods are for one thread.

    Args:
        create: copies a process, with the folder for the copy's files; see `EngineClient.fork`.
    """

    def __init__(self, create: Callable[[EngineClient, Path], EngineClient]) -> None:
        self._create = create
        self._idle: list[EngineClient] = []
        self._numbers = itertools.count(1)

    def lend(self, originals: Sequence[EngineClient], folder: Path) -> list[EngineClient]:
        """Return a copy of each process at its sample; one process may occur several times.

        Args:
            originals: the processes.
            folder: for their states; the copies have folders of their own beside it.

        Raises:
            ForkFailed: a state cannot be saved, or the system lacks the resources.
            SimulatorError: a process has failed, or `restore` has.
        """
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise ForkFailed(f"the node has no room for a copy's files: {error}") from None
        states: dict[int, Path] = {}
        copies: list[EngineClient] = []
        try:
            for original in originals:
                if id(original) not in states:
                    states[id(original)] = folder / f"{len(states)}.pickle"
                    original.save(states[id(original)])
                copies.append(self._ordered(original, states[id(original)]))
            for position, original in enumerate(originals):
                copies[position] = self._received(copies[position], original, states[id(original)])
        except BaseException:
            close_all(copies)
            raise
        return copies

    def _ordered(self, original: EngineClient, state: Path) -> EngineClient:
        """Return a copy that has the order to restore a state."""
        for copy in self._waiting():
            try:
                copy.send_restore(state)
            except EngineDied:
                copy.close()
            else:
                return copy
        return self._created(original, state)

    def _waiting(self) -> Iterator[EngineClient]:
        while self._idle:
            yield self._idle.pop()

    def _created(self, original: EngineClient, state: Path) -> EngineClient:
        copy = self._create(original, state.parent.parent / f"kept-{next(self._numbers)}")
        try:
            copy.send_restore(state)
        except BaseException:
            copy.close()
            raise
        return copy

    def _received(self, copy: EngineClient, original: EngineClient, state: Path) -> EngineClient:
        """Return a copy that has restored its state; one that was killed while it waited is replaced."""
        try:
            copy.receive()
        except EngineDied:
            copy.close()
            if copy.interrupted:
                raise
        else:
            return copy
        copy = self._created(original, state)
        try:
            copy.receive()
        except SimulatorError:
            copy.close()
            raise
        return copy

    def give_back(self, copies: Sequence[EngineClient]) -> None:
        """Keep copies that wait at a sample for the next trial."""
        self._idle += copies

    def close(self) -> None:
        """End those that wait; idempotent."""
        idle, self._idle = self._idle, []
        close_all(idle)
