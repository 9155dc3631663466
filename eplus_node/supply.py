"""Engines at sample 0: forked from one that waits there, started beforehand for the next weather, or started now."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from eplus_node.config import Plan
from eplus_node.link import EngineLink, Run
from models.episode import Draw, Draws, Episodes, Files, Source
from topics.errors import SimulatorError
from topics.messages import Start


@dataclass(frozen=True, slots=True)
class _Ahead:
    """An engine that was started before its episode."""

    draw: Draw
    files: Files
    engine: EngineLink


class Supply:
    """Has an engine for each episode of a node.

    Where each episode begins alike, the first engine stays at sample 0 and each episode gets a fork of it. Where the
    weather changes, the engine of the next episode is started while the present one runs. Where EnergyPlus's files
    are kept, each engine is started for its own folder.

    Args:
        plan: of the node.
        folder: for the files of engines; the caller removes it.
        cpu: the engines' core, and whether they poll there.

    Attributes:
        draw: the weather of the present episode.
        files: what it reads.
    """

    def __init__(self, plan: Plan, folder: Path, *, cpu: int | None, poll: bool) -> None:
        scenario, keep = plan.scenario, plan.config.keep
        self._plan, self._cpu, self._poll = plan, cpu, poll
        self._keep, self._folder = keep is not None, keep.absolute() if keep else folder
        self._draws = Draws(len(plan.sources), scenario.weather_order, noisy=bool(scenario.variability))
        self._episodes = Episodes(plan.building, plan.period, plan.sources, scenario.variability, outputs=self._keep)
        self._turned = False
        self._seeds = 0  # in a row, lately
        self._waiting: tuple[Draw, EngineLink] | None = None
        self._ahead: _Ahead | None = None
        self.draw = self._draws.next()
        self.files = self._prepared(self.draw, 0)

    @property
    def source(self) -> Source:
        """The weather file of the present episode."""
        return self._plan.sources[self.draw.source]

    @property
    def outputs(self) -> str:
        """The folder of the present episode's own EnergyPlus files; empty if they are not kept."""
        return str(self.files.model.parent) if self._keep else ""

    def turn(self, seed: int | None, episode: int, *, untouched: bool) -> Start:
        """Turns to the next episode: draws its weather, and says how its engine will come.

        Args:
            seed: begins the draws anew; None goes on. The first episode's is drawn already.
            episode: its number.
            untouched: whether the present engine still waits at sample 0.
        """
        former, self.draw = self.draw, self._drawn(seed)
        if untouched and self.draw == former:
            return Start.READY
        if self._can_fork():
            return Start.FORKED
        if self._ahead is not None and self._ahead.draw == self.draw and self._ahead.engine.alive:
            self._let_go(self.files, keeping=self._ahead.files)
            self.files = self._ahead.files
            return Start.AHEAD
        self._drop_ahead()
        former_files, self.files = self.files, self._prepared(self.draw, episode)
        self._let_go(former_files, keeping=self.files)
        return Start.STARTED

    def _drawn(self, seed: int | None) -> Draw:
        first, self._turned = not self._turned, True
        self._seeds = 0 if seed is None else self._seeds + 1
        if seed is not None:
            self._draws.seed(seed)
            return self._draws.next()
        if first:
            return self.draw
        return self._ahead.draw if self._ahead is not None else self._draws.next()

    def engine(self, episode: int) -> EngineLink:
        """An engine at sample 0 of the present episode.

        Raises:
            SimulatorError: EnergyPlus does not simulate this model, or its process died.
        """
        if self._can_fork():
            try:
                return self._forked(episode)
            except SimulatorError:
                self._drop_waiting()  # it has died meanwhile, and its files go with it
                self.files = self._prepared(self.draw, episode)
        ahead, self._ahead = self._ahead, None
        engine = ahead.engine if ahead is not None and ahead.draw == self.draw else self._begun(self.files, self._cpu)
        try:
            engine.receive()
        except BaseException:
            engine.close()
            raise
        if ahead is not None and self._cpu is not None:
            os.sched_setaffinity(engine.pid, {self._cpu})
        if self._keep or not self._draws.constant:
            return engine
        self._waiting = (self.draw, engine)
        return self._forked(episode)

    def look_ahead(self, episode: int) -> None:
        """Starts the engine of the next episode, if its weather is another one; it warms up on its own.

        Whoever gives a seed to each reset is not foreseen.
        """
        if self._keep or self._draws.constant or self._ahead is not None or self._seeds > 1:
            return
        draw = self._draws.next()
        files = self._prepared(draw, episode + 1)
        self._ahead = _Ahead(draw, files, self._begun(files, None))

    def close(self) -> None:
        """Ends the engines that wait; twice is fine."""
        self._drop_waiting()
        self._drop_ahead()

    def _can_fork(self) -> bool:
        return self._waiting is not None and self._waiting[0] == self.draw and self._waiting[1].alive

    def _forked(self, episode: int) -> EngineLink:
        assert self._waiting is not None
        folder = self._folder / f"episode-{episode:04}-fork"
        folder.mkdir()
        engine = self._waiting[1].fork(self._run(self.files, folder, self._cpu))
        try:
            engine.receive()
        except BaseException:
            engine.close()
            raise
        return engine

    def _begun(self, files: Files, cpu: int | None) -> EngineLink:
        return EngineLink(self._run(files, files.model.parent, cpu))

    def _prepared(self, draw: Draw, episode: int) -> Files:
        """An episode's weather outlives its engine, which clears its own folder."""
        folder = self._folder / f"episode-{episode:04}"
        while not self._keep and folder.exists():
            folder = folder.with_name(f"{folder.name}-")
        folder.mkdir(parents=True, exist_ok=True)
        weather = folder / "in.epw" if self._keep else folder.with_suffix(".epw")
        return self._episodes.prepare(draw, folder, weather)

    def _let_go(self, files: Files, *, keeping: Files) -> None:
        if not self._keep and files.weather != keeping.weather and files.weather.parent == self._folder:
            files.weather.unlink(missing_ok=True)

    def _drop_waiting(self) -> None:
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            waiting[1].close()

    def _drop_ahead(self) -> None:
        ahead, self._ahead = self._ahead, None
        if ahead is not None:
            ahead.engine.close()
            self._let_go(ahead.files, keeping=self.files)

    def _run(self, files: Files, folder: Path, cpu: int | None) -> Run:
        plan = self._plan
        return Run(
            files.model,
            files.weather,
            folder,
            plan.period.steps,
            plan.period.steps_per_hour,
            plan.points,
            keep=self._keep,
            cpu=cpu,
            poll=self._poll,
        )
