"""Provide an engine at sample 0 for each episode: reused, forked from a template, prefetched or newly started."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.engine.registry import EngineRegistry
from zenostat.bridge.engine.spec import EngineSpec
from zenostat.eplus_node.engine_spec import engine_spec
from zenostat.eplus_node.episode_folders import EpisodeFolders, is_used
from zenostat.eplus_node.fork_template import EngineTemplate
from zenostat.eplus_node.plan import Plan
from zenostat.models.scenario.episode_weather import EpisodeFiles, WeatherDraw, WeatherSampler
from zenostat.topics.errors import EngineDied, ForkFailed, InvalidRecording, SimulatorError
from zenostat.topics.messages import EngineStart


@dataclass(frozen=True, slots=True)
class PrefetchedEngine:
    """An engine that was started before its episode."""

    draw: WeatherDraw
    files: EpisodeFiles
    engine: EngineClient


@dataclass(frozen=True, slots=True)
class EpisodeWeather:
    """The weather of an episode: what a snapshot keeps of a pool."""

    draw: WeatherDraw
    files: EpisodeFiles


class EnginePool:
    """The engines of one slot of a node.

    If all episodes begin alike, the first engine stays at sample 0 as a template and each episode gets a fork of it. If
    the noise starts on the third day, there is a template for each weather file, and a fork continues with the weather
    of its episode. If the weather differs from the start, the engine of the next episode starts while the present one
    is running. If EnergyPlus's output is kept, each episode gets a new engine with a folder of its own.

    Args:
        plan: of the node.
        folder: for the files of engines; the caller removes it.
        templates: one for each weather file, shared by the slots.
        subfolder: the slot's part of `folder`, and of the folder where output is kept.
        cpus: cores of the engine; empty leaves it to the system.
        spare: cores on which the engine of the next episode starts, likewise.
        poll: whether the engine polls for orders before it sleeps.
        registry: of the node's engines.

    Attributes:
        draw: the weather of the present episode.
        files: what it reads.
        warnings: engines that were replaced, with the reason; the caller empties the list.
    """

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        templates: Sequence[EngineTemplate],
        *,
        subfolder: str = "",
        cpus: Sequence[int] = (),
        spare: Sequence[int] = (),
        poll: bool = False,
        registry: EngineRegistry | None = None,
    ) -> None:
        scenario = plan.scenario
        self._plan, self._cpus, self._spare, self._poll = plan, tuple(cpus), tuple(spare), poll
        self._registry = registry or EngineRegistry()
        self._folders = EpisodeFolders(plan, folder, subfolder)
        self._draws = WeatherSampler(len(plan.sources), scenario.weather_order, noisy=bool(scenario.weather_noise))
        self.warnings: list[str] = []
        self._episode = 0
        self._templates = templates
        # EnergyPlus's end of run writes into the folder of the engine that was forked.
        self._end_as_branch = self._folders.keep or bool(subfolder)
        self._starting: EngineClient | None = None
        self._prefetched: PrefetchedEngine | None = None
        self._output_kept = self._folders.keep
        first = self._draws.look_ahead()
        assert first is not None
        self.draw = first
        shared = self._template.files if self._draws.constant and not self._folders.keep else None
        self.files = shared if shared is not None else self._prepare_files(0)
        if self._draws.constant and not self._folders.keep:
            self._template.files = self.files

    @property
    def _has_late_noise(self) -> bool:
        """Whether an episode continues from a template with noise of its own."""
        scenario = self._plan.scenario
        return bool(scenario.weather_noise) and scenario.noise_start == "third_day" and not self._folders.keep

    @property
    def _uses_template(self) -> bool:
        return (self._draws.constant or self._has_late_noise) and not self._folders.keep

    @property
    def _template(self) -> EngineTemplate:
        """The template of the present episode's weather file."""
        return self._templates[self.draw.source]

    @property
    def _template_draw(self) -> WeatherDraw:
        return WeatherDraw(self.draw.source)

    @property
    def output_dir(self) -> str:
        """The folder of EnergyPlus's output of the present episode; empty if it is not kept."""
        return str(self.files.model.parent) if self._output_kept else ""

    def next_episode(self, seed: int | None, episode: int, *, untouched: Sequence[EngineClient] = ()) -> EngineStart:
        """Draw the weather of the next episode, and return where its engine will come from.

        Args:
            seed: restarts the sequence of draws; None continues it. The first episode is drawn on construction.
            episode: its number.
            untouched: the engines of the present episode, if they still wait at its sample 0.
        """
        return self._begin(self._draws.draw(seed), episode, untouched=untouched, is_seeded=seed is not None)

    def repeat_episode(self, draw: WeatherDraw, episode: int) -> EngineStart:
        """Begin an episode with this weather, and return where its engine will come from; no other one is prefetched.

        Raises:
            InvalidRecording: the plan has no such weather.
        """
        if not (0 <= draw.source < len(self._plan.sources) and 0 <= draw.noise < 1 << 63):
            raise InvalidRecording(f"there is no weather {draw}; the scenario has {len(self._plan.sources)} files")
        self._draws.expect_seed()
        return self._begin(draw, episode, untouched=(), is_seeded=True)

    def _begin(
        self, draw: WeatherDraw, episode: int, *, untouched: Sequence[EngineClient], is_seeded: bool
    ) -> EngineStart:
        self._drop_starting()
        self._episode = episode
        previous, self.draw = self.draw, draw
        output_kept, self._output_kept = self._output_kept, self._folders.keep
        if self.draw == previous and output_kept == self._folders.keep and self._are_alive(untouched):
            if is_seeded:
                self._drop_prefetched()  # it was drawn after the previous seed
            return EngineStart.REUSED
        if self._has_late_noise:
            is_waiting = self._can_fork()
            self._replace_files(self._prepare_files(episode))
            return EngineStart.FORKED if is_waiting else EngineStart.STARTED
        if self._can_fork():
            return EngineStart.FORKED
        prefetched = self._prefetched
        if prefetched is not None and prefetched.draw == self.draw and prefetched.engine.alive:
            self._folders.release(self.files, keeping=prefetched.files)
            self.files = prefetched.files
            return EngineStart.PREFETCHED
        self._drop_prefetched()
        self._replace_files(self._prepare_files(episode))
        return EngineStart.STARTED

    def _are_alive(self, engines: Sequence[EngineClient]) -> bool:
        """Return whether there are engines, and all of them answer."""
        try:
            for engine in engines:
                engine.confirm()
        except EngineDied as error:
            self.warnings.append(f"the engine waiting at sample 0 is replaced: {error}")
            return False
        return bool(engines)

    def _prepare_files(self, episode: int) -> EpisodeFiles:
        """Write the files of the present episode, and those of its template if there are none."""
        if not self._has_late_noise:
            return self._folders.prepare(self.draw, episode)
        template = self._template
        if template.files is None:
            template.files, template.noise_offset = self._folders.prepare_waiting(self.draw.source)
        return self._folders.prepare_noise(self.draw, template.files, episode)

    def start(self) -> None:
        """Start the engine of the present episode unless there is one; it advances to sample 0 on its own."""
        if self._starting is not None or self._can_fork() or self._is_prefetched():
            return
        # The folder of an engine that has died since is removed at its end.
        if self._has_late_noise:
            template = self._template
            if template.files is None or is_used(template.files):
                template.files, template.noise_offset = self._folders.prepare_waiting(self.draw.source)
            files = template.files
        else:
            if is_used(self.files):
                self._replace_files(self._folders.prepare(self.draw, self._episode))
            files = self.files
        engine = self._start_engine(files, self._cpus)
        if self._uses_template:
            self._template.replace(self._template_draw, files, engine)
        else:
            self._starting = engine

    def engine(self, episode: int) -> EngineClient:
        """Return the engine of the present episode, at sample 0.

        Raises:
            SimulatorError: EnergyPlus does not simulate this model, or its process died.
        """
        self.start()
        if self._uses_template:
            return self._fork_template(episode)
        prefetched, self._prefetched = self._prefetched, None
        starting, self._starting = self._starting, None
        engine = prefetched.engine if starting is None and prefetched is not None else starting
        assert engine is not None
        try:
            _receive_first(engine)
            if prefetched is not None:
                engine.confirm()  # its frame may have arrived long before
        except EngineDied as error:
            if prefetched is None or self._registry.closing:
                raise
            self.warnings.append(f"the prefetched engine is replaced: {error}")
            self.start()
            return self.engine(episode)
        if prefetched is not None and self._cpus:
            os.sched_setaffinity(engine.pid, self._cpus)
        return engine

    def prefetch(self, episode: int) -> None:
        """Start the engine of the next episode if its weather differs; it advances to sample 0 on its own.

        With a seed at each reset the next weather is unknown, and nothing is started.
        """
        is_needed = not (self._folders.keep or self._uses_template or self._prefetched is not None)
        if not is_needed or (draw := self._draws.look_ahead()) is None:
            return
        with suppress(SimulatorError):  # its files cannot be written now; it starts when the episode begins
            files = self._folders.prepare(draw, episode + 1)
            self._prefetched = PrefetchedEngine(draw, files, self._start_engine(files, self._spare))

    # Snapshots

    @property
    def weather(self) -> EpisodeWeather:
        """The weather of the present episode."""
        return EpisodeWeather(self.draw, self.files)

    def fork(self, parent: EngineTemplate | EngineClient, episode: int) -> EngineClient:
        """Fork the template, or the engine of a snapshot, at its sample.

        Raises:
            SimulatorError: it has died, or cannot be forked.
        """
        folder = self._folders.create_fork(episode)
        try:
            spec = self._spec(self.files, folder, self._cpus, keep_output=False, branch=self._end_as_branch)
            if self._has_late_noise and isinstance(parent, EngineTemplate) and parent.files is not None:
                weather = str(parent.files.weather), str(self.files.weather)
                spec = replace(spec, replaced_file=(*weather, parent.noise_offset))
            engine = parent.fork(spec)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return _receive_first(engine)

    def restored_weather(self, episode: int) -> Path:
        """Return the path for the weather file of an episode that continues from a snapshot."""
        return self._folders.restored_weather(episode)

    def restore(self, weather: EpisodeWeather) -> None:
        """Continue with the weather of a snapshot, linked to `restored_weather`."""
        self.draw = weather.draw
        self._replace_files(weather.files)
        self._output_kept = False

    def close(self) -> None:
        """End the engines that are waiting; idempotent."""
        for template in self._templates:
            template.close()
        self._drop_prefetched()
        self._drop_starting()

    def _drop_starting(self) -> None:
        starting, self._starting = self._starting, None
        if starting is not None:
            starting.close()

    def _drop_prefetched(self) -> None:
        prefetched, self._prefetched = self._prefetched, None
        if prefetched is not None:
            prefetched.engine.close()
            self._folders.release(prefetched.files, keeping=self.files)

    def _replace_files(self, files: EpisodeFiles) -> None:
        previous, self.files = self.files, files
        self._folders.release(previous, keeping=files)

    def _is_prefetched(self) -> bool:
        return self._prefetched is not None and self._prefetched.draw == self.draw

    def _can_fork(self) -> bool:
        return self._uses_template and self._template.has(self._template_draw)

    def _fork_template(self, episode: int) -> EngineClient:
        assert self._template.engine is not None
        try:
            return self.fork(self._template, episode)
        except ForkFailed:
            raise
        except SimulatorError as error:
            is_new = not self._template.ready
            self._template.close()
            if is_new or self._registry.closing:
                raise
            self.warnings.append(f"the engine waiting to be forked is replaced: {error}")
        self.start()  # with new files: those of the dead engine were removed
        return self.fork(self._template, episode)

    def _start_engine(self, files: EpisodeFiles, cpus: Sequence[int]) -> EngineClient:
        try:
            spec = self._spec(files, files.model.parent, cpus, keep_output=self._folders.keep)
            return EngineClient(spec, registry=self._registry)
        except OSError as error:
            raise EngineDied(f"cannot start an engine: {error}") from None

    def _spec(
        self, files: EpisodeFiles, folder: Path, cpus: Sequence[int], *, keep_output: bool, branch: bool = False
    ) -> EngineSpec:
        return engine_spec(
            self._plan, files, folder, keep_output=keep_output, cpus=tuple(cpus), poll=self._poll, branch=branch
        )


def _receive_first(engine: EngineClient) -> EngineClient:
    try:
        engine.receive()
    except BaseException:
        engine.close()
        raise
    return engine
