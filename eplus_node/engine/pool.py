"""Engines at sample 0: forked from one that waits there, started beforehand for the next weather, or started now."""

from __future__ import annotations

import os
import shutil
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eplus_node.config import Plan, kept_episodes
from eplus_node.engine.client import LOG, EngineClient
from eplus_node.engine.registry import EngineRegistry
from eplus_node.engine.spec import EngineSpec
from models.scenario.episode import EpisodeFactory, EpisodeFiles, WeatherDraw, WeatherSampler, WeatherSource
from topics.errors import EngineDied, ForkFailed, SimulatorError
from topics.messages import EngineStart


@dataclass(frozen=True, slots=True)
class PrefetchedEngine:
    """An engine that was started before its episode."""

    draw: WeatherDraw
    files: EpisodeFiles
    engine: EngineClient


class EngineTemplate:
    """The engine that waits at sample 0 to be forked; the slots of a node share one."""

    def __init__(self) -> None:
        self.draw = WeatherDraw()
        self.files: EpisodeFiles | None = None
        self.engine: EngineClient | None = None
        self.told = False  # whether it has come to sample 0

    def has(self, draw: WeatherDraw) -> bool:
        """Whether an engine of this weather waits, or is about to."""
        return self.engine is not None and self.draw == draw and self.engine.alive

    def take(self, draw: WeatherDraw, files: EpisodeFiles, engine: EngineClient) -> None:
        """Has an engine wait; it may still be on its way to sample 0."""
        self.close()
        self.draw, self.files, self.engine, self.told = draw, files, engine, False

    def fork(self, run: EngineSpec) -> EngineClient:
        """A fork of it.

        Raises:
            SimulatorError: it could not simulate the model, has died, or cannot be forked.
        """
        assert self.engine is not None
        if not self.told:
            self.engine.receive()
            self.told = True
        return self.engine.fork(run)

    def close(self) -> None:
        """Ends it; twice is fine."""
        engine, self.engine = self.engine, None
        if engine is not None:
            engine.close()


@dataclass(frozen=True, slots=True)
class EpisodeWeather:
    """Which weather an episode has: what a snapshot remembers of a supply."""

    draw: WeatherDraw
    files: EpisodeFiles


class EnginePool:
    """Has an engine for each episode of one slot of a node.

    Where each episode begins alike, the first engine stays at sample 0 and each episode gets a fork of it. Where the
    weather changes, the engine of the next episode is started while the present one runs. Where EnergyPlus's files
    are kept, each engine is started for its own folder.

    Args:
        plan: of the node.
        folder: for the files of engines; the caller removes it.
        waiting: shared by the slots.
        place: the slot's own folder, below that one and below the one where files are kept.
        cpus: the engine's core; empty leaves it to the system.
        spare: where the engine of the next episode starts, likewise.
        poll: whether the engine polls there.
        registry: of the node's engines.

    Attributes:
        draw: the weather of the present episode.
        files: what it reads.
        warnings: engines that were replaced, and why, since somebody last looked.
    """

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        waiting: EngineTemplate,
        *,
        place: str = "",
        cpus: Sequence[int] = (),
        spare: Sequence[int] = (),
        poll: bool = False,
        registry: EngineRegistry | None = None,
    ) -> None:
        scenario, output_dir = plan.scenario, plan.config.output_dir
        self._plan, self._cpus, self._spare, self._poll = plan, tuple(cpus), tuple(spare), poll
        self._registry = registry or EngineRegistry()
        self._keep, self._scratch = output_dir is not None, folder / place
        self._keep_last, self._kept_folders = kept_episodes(plan.config), deque[Path]()
        self._folder = output_dir.absolute() / place if output_dir else self._scratch
        self._draws = WeatherSampler(len(plan.sources), scenario.weather_order, noisy=bool(scenario.weather_noise))
        self._episodes = EpisodeFactory(
            plan.building, plan.period, plan.sources, scenario.weather_noise, outputs=self._keep
        )
        self.warnings: list[str] = []
        self._turned = False
        self._episode = 0
        self._seeds = 0  # in a row, lately
        self._waiting = waiting
        # The end of a run writes into the folder of the engine that it was forked from.
        self._branches = self._keep or bool(place)
        self._begun: EngineClient | None = None
        self._following: WeatherDraw | None = None
        self._ahead: PrefetchedEngine | None = None
        self._kept = self._keep
        self.draw = self._draws.next()
        shared = waiting.files if self._shares else None
        self.files = shared if shared is not None else self._prepared(self.draw, 0)
        if self._shares:
            waiting.files = self.files

    @property
    def _shares(self) -> bool:
        return self._draws.constant and not self._keep

    @property
    def source(self) -> WeatherSource:
        """The weather file of the present episode."""
        return self.source_of(self.position)

    @property
    def output_dir(self) -> str:
        """The folder of the present episode's own EnergyPlus files; empty if they are not kept."""
        return str(self.files.model.parent) if self._kept else ""

    def next_episode(self, seed: int | None, episode: int, *, untouched: bool) -> EngineStart:
        """Turns to the next episode: draws its weather, and says how its engine will come.

        Args:
            seed: begins the draws anew; None goes on. The first episode's is drawn already.
            episode: its number.
            untouched: whether the present engine still waits at sample 0.
        """
        self._drop_begun()
        self._episode = episode
        former, self.draw = self.draw, self._drawn(seed)
        kept, self._kept = self._kept, self._keep
        if untouched and self.draw == former and kept == self._keep:
            if seed is not None:
                self._drop_ahead()  # it was drawn after the former seed
            return EngineStart.REUSED
        if self._can_fork():
            return EngineStart.FORKED
        if self._ahead is not None and self._ahead.draw == self.draw and self._ahead.engine.alive:
            self._let_go(self.files, keeping=self._ahead.files)
            self.files = self._ahead.files
            return EngineStart.PREFETCHED
        self._drop_ahead()
        former_files, self.files = self.files, self._prepared(self.draw, episode)
        self._let_go(former_files, keeping=self.files)
        return EngineStart.STARTED

    def _drawn(self, seed: int | None) -> WeatherDraw:
        first, self._turned = not self._turned, True
        self._seeds = 0 if seed is None else self._seeds + 1
        if first and seed is None:
            return self.draw
        following, self._following = self._following, None
        if seed is not None:
            self._draws.seed(seed)
        elif following is not None:
            return following
        return self._draws.next()

    def begin(self) -> None:
        """Starts the engine of the present episode, unless it is there already; it comes to sample 0 on its own."""
        if self._begun is not None or self._can_fork() or (self._ahead is not None and self._ahead.draw == self.draw):
            return
        if _used(self.files):  # by an engine that has died meanwhile, and whose end clears its folder
            former, self.files = self.files, self._prepared(self.draw, self._episode)
            self._let_go(former, keeping=self.files)
        engine = self._started(self.files, self._cpus)
        if self._shares:
            self._waiting.take(self.draw, self.files, engine)
        else:
            self._begun = engine

    def engine(self, episode: int) -> EngineClient:
        """The engine of the present episode, at sample 0.

        Raises:
            SimulatorError: EnergyPlus does not simulate this model, or its process died.
        """
        self.begin()
        if self._shares:
            return self._forked(episode)
        ahead, self._ahead = self._ahead, None
        begun, self._begun = self._begun, None
        engine = ahead.engine if begun is None and ahead is not None else begun
        assert engine is not None
        try:
            _received(engine)
        except EngineDied as error:
            if ahead is None or self._registry.closing:
                raise
            self.warnings.append(f"the engine that was started ahead is replaced: {error}")
            self.begin()  # the one that was started ahead harms no episode
            return self.engine(episode)
        if ahead is not None and self._cpus:
            os.sched_setaffinity(engine.pid, self._cpus)
        return engine

    def prefetch(self, episode: int) -> None:
        """Starts the engine of the next episode, if its weather is another one; it warms up on its own.

        Whoever gives a seed to each reset is not foreseen.
        """
        if self._keep or self._draws.constant or self._ahead is not None or self._seeds > 1:
            return
        draw = self._following = self._draws.next()
        with suppress(EngineDied):  # there is no room for it now; it is started when it is due
            files = self._prepared(draw, episode + 1)
            self._ahead = PrefetchedEngine(draw, files, self._started(files, self._spare))

    # Snapshots

    @property
    def position(self) -> EpisodeWeather:
        """Which weather the present episode has."""
        return EpisodeWeather(self.draw, self.files)

    def source_of(self, position: EpisodeWeather) -> WeatherSource:
        """Its weather file, as it is without noise."""
        return self._plan.sources[position.draw.source]

    def hold(self, position: EpisodeWeather, path: Path) -> EpisodeWeather:
        """The same position, whose weather is held at `path`, too, unless it stays anyway.

        Raises:
            ForkFailed: there is no room for it.
        """
        if position.files.weather == self.source_of(position).path or self._keep:
            return position
        try:
            path.unlink(missing_ok=True)
            os.link(position.files.weather, path)
        except OSError as error:
            raise ForkFailed(disk_full_message("a fork's weather", error)) from None
        return EpisodeWeather(position.draw, replace(position.files, weather=path))

    def fork(self, engine: EngineClient, episode: int) -> EngineClient:
        """A fork of a snapshot's engine, at its sample.

        Raises:
            SimulatorError: it has died, or cannot be forked.
        """
        return self._child(engine, episode)

    def hold_for(self, position: EpisodeWeather, episode: int) -> EpisodeWeather:
        """A snapshot's position, held for an episode that goes back there; raises as `hold` does."""
        return self.hold(position, self._folder / f"episode-{episode:04}-back.epw")

    def go_back(self, position: EpisodeWeather) -> None:
        """Turns to a position that is held for it."""
        former, self.draw, self.files = self.files, position.draw, position.files
        self._kept = False
        self._let_go(former, keeping=self.files)

    def close(self) -> None:
        """Ends the engines that wait; twice is fine."""
        self._waiting.close()
        self._drop_ahead()
        self._drop_begun()

    def _drop_begun(self) -> None:
        begun, self._begun = self._begun, None
        if begun is not None:
            begun.close()

    def _can_fork(self) -> bool:
        return self._shares and self._waiting.has(self.draw)

    def _forked(self, episode: int) -> EngineClient:
        assert self._waiting.engine is not None
        try:
            return self._child(self._waiting, episode)
        except ForkFailed:
            raise
        except SimulatorError as error:
            fresh = not self._waiting.told
            self._waiting.close()
            if fresh or self._registry.closing:
                raise
            self.warnings.append(f"the engine that waits to be forked is replaced: {error}")
        self.begin()  # it has died meanwhile, and its files went with it
        return self._child(self._waiting, episode)

    def _child(self, of: EngineTemplate | EngineClient, episode: int) -> EngineClient:
        folder = made(self._scratch / f"episode-{episode:04}-fork")
        try:
            engine = of.fork(self._run(self.files, folder, self._cpus, keep_output=False, branch=self._branches))
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return _received(engine)

    def _started(self, files: EpisodeFiles, cpus: Sequence[int]) -> EngineClient:
        try:
            run = self._run(files, files.model.parent, cpus, keep_output=self._keep)
            return EngineClient(run, registry=self._registry)
        except OSError as error:
            raise EngineDied(f"no engine could be started: {error}") from None

    def _prepared(self, draw: WeatherDraw, episode: int) -> EpisodeFiles:
        """An episode's weather outlives its engine, which clears its own folder."""
        folder = self._folder / f"episode-{episode:04}"
        try:
            while not self._keep and folder.exists():
                folder = folder.with_name(f"{folder.name}-")
            folder.mkdir(parents=True, exist_ok=True)
            weather = folder / "in.epw" if self._keep else folder.with_suffix(".epw")
            self._sweep(folder)
            return self._episodes.prepare(draw, folder, weather)
        except OSError as error:
            raise EngineDied(disk_full_message("an engine's files", error)) from None

    def _sweep(self, folder: Path) -> None:
        """Removes the kept files of episodes before the last ones; the former one's engine may still write its own."""
        if not self._keep or self._keep_last is None:
            return
        self._kept_folders.append(folder)
        while len(self._kept_folders) > self._keep_last + 1:
            shutil.rmtree(self._kept_folders.popleft(), ignore_errors=True)

    def _let_go(self, files: EpisodeFiles, *, keeping: EpisodeFiles) -> None:
        if not self._keep and files.weather != keeping.weather and files.weather.parent == self._folder:
            with suppress(OSError):  # it goes with the node's folder at the latest
                files.weather.unlink()

    def _drop_ahead(self) -> None:
        ahead, self._ahead = self._ahead, None
        if ahead is not None:
            ahead.engine.close()
            self._let_go(ahead.files, keeping=self.files)

    def _run(
        self, files: EpisodeFiles, folder: Path, cpus: Sequence[int], *, keep_output: bool, branch: bool = False
    ) -> EngineSpec:
        plan = self._plan
        return EngineSpec(
            files.model,
            files.weather,
            folder,
            plan.period.steps,
            plan.period.steps_per_hour,
            plan.points,
            keep_output=keep_output,
            cpus=tuple(cpus),
            poll=self._poll,
            branch=branch,
        )


def _used(files: EpisodeFiles) -> bool:
    """Whether an engine has been started with these files: each has a folder of its own, which goes with it."""
    return not files.model.exists() or (files.model.parent / LOG).exists()


def weather_fields(source: WeatherSource) -> dict[str, Any]:
    """What a manifest tells of a weather file."""
    header = source.header
    return {
        "weather": source.name,
        "location": header.place,
        "latitude_deg": header.latitude_deg,
        "longitude_deg": header.longitude_deg,
    }


def made(folder: Path) -> Path:
    """A new folder for a fork's files; `ForkFailed` if there is no room for it."""
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ForkFailed(disk_full_message("a fork's files", error)) from None
    return folder


def disk_full_message(what: str, error: OSError) -> str:
    """What is told where the system has no room for files."""
    return f"the node has no room for {what}: {error}"


def _received(engine: EngineClient) -> EngineClient:
    try:
        engine.receive()
    except BaseException:
        engine.close()
        raise
    return engine
