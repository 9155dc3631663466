"""Folders and files of the episodes of one slot: create them, keep the last ones, remove the others."""

from __future__ import annotations

import errno
import os
import shutil
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from zenostat.bridge.engine.launch import LOG
from zenostat.eplus_node.config import kept_episodes
from zenostat.eplus_node.plan import Plan
from zenostat.models.scenario.episode_weather import EpisodeFactory, EpisodeFiles, WeatherDraw
from zenostat.topics.errors import EngineDied, ForkFailed, SimulatorError, UsageError
from zenostat.topics.user_file import absolute


class EpisodeFolders:
    """Folders in which the engines of one slot read and write.

    Args:
        plan: of the node.
        folder: for files that are not kept; the caller removes it.
        subfolder: the slot's part of it, and of the folder where output is kept.

    Attributes:
        keep: whether EnergyPlus's output files are kept.
    """

    def __init__(self, plan: Plan, folder: Path, subfolder: str) -> None:
        output_dir = plan.config.output_dir
        self.keep, self._scratch = output_dir is not None, folder / subfolder
        self._keep_last, self._kept_folders = kept_episodes(plan.config), deque[Path]()
        self._folder = absolute(output_dir) / subfolder if output_dir else self._scratch
        self._factory = EpisodeFactory(
            plan.building,
            plan.period,
            plan.sources,
            plan.scenario.weather_noise,
            outputs=self.keep,
            requested=plan.points.requested,
            noise_start=plan.scenario.noise_start,
        )

    def prepare(self, draw: WeatherDraw, episode: int) -> EpisodeFiles:
        """Write model and weather of an episode.

        The weather file is not in the engine's folder, since it must outlive the engine, which removes its folder.

        Raises:
            EngineDied: the files cannot be written.
            SimulatorError: the weather file has changed since the node started, and is not valid.
        """
        with _file_errors("an engine's files"):
            folder = self._create(f"episode-{episode:04}")
            weather = folder / "in.epw" if self.keep else folder.with_suffix(".epw")
            self._remove_oldest(folder)
            return self._factory.prepare(draw, folder, weather)

    def prepare_waiting(self, source: int) -> tuple[EpisodeFiles, int]:
        """Write model and weather of an engine that waits to be forked with other noise.

        Returns:
            Its files, and the offset in bytes from which the weather of an episode may differ.

        Raises:
            EngineDied, SimulatorError: see `prepare`.
        """
        with _file_errors("an engine's files"):
            folder = self._create(f"waiting-{source}")
            return self._factory.prepare_waiting(source, folder, folder.with_suffix(".epw"))

    def prepare_noise(self, draw: WeatherDraw, waiting: EpisodeFiles, episode: int) -> EpisodeFiles:
        """Write the weather of an episode that continues from an engine that waits.

        Raises:
            EngineDied, SimulatorError: see `prepare`.
        """
        weather = self._folder / f"episode-{episode:04}.epw"
        while weather.exists():  # an engine may be reading it
            weather = weather.with_stem(f"{weather.stem}-")
        with _file_errors("an episode's weather"):
            self._folder.mkdir(parents=True, exist_ok=True)
            return EpisodeFiles(waiting.model, weather, self._factory.write_noise(draw, weather))

    def _create(self, name: str) -> Path:
        folder = self._folder / name
        while not self.keep and folder.exists():
            folder = folder.with_name(f"{folder.name}-")
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _remove_oldest(self, folder: Path) -> None:
        """Remove kept output beyond the last episodes, except that of an engine that may still be writing."""
        if not self.keep or self._keep_last is None:
            return
        self._kept_folders.append(folder)
        while len(self._kept_folders) > self._keep_last + 1:
            shutil.rmtree(self._kept_folders.popleft(), ignore_errors=True)

    def create_fork(self, episode: int) -> Path:
        """Create the folder of a forked engine; raise `ForkFailed` if it cannot be created."""
        return create_fork_folder(self._scratch / f"episode-{episode:04}-fork")

    def restored_weather(self, episode: int) -> Path:
        """Return the path of the weather file of an episode that continues from a snapshot."""
        return self._folder / f"episode-{episode:04}-back.epw"

    def release(self, files: EpisodeFiles, *, keeping: EpisodeFiles) -> None:
        """Remove an episode's weather file, unless output is kept or `keeping` has the same file."""
        if not self.keep and files.weather != keeping.weather and files.weather.parent == self._folder:
            with suppress(OSError):  # it is removed with the node's folder at the latest
                files.weather.unlink()


@contextmanager
def _file_errors(files: str) -> Iterator[None]:
    """Raise errors of an episode's files as those of the simulator: they end the episode, and not the node."""
    try:
        yield
    except OSError as error:
        raise EngineDied(file_error(files, error)) from None
    except UsageError as error:
        raise SimulatorError(f"the node cannot prepare {files}: {error}") from None


def link_weather(files: EpisodeFiles, path: Path) -> EpisodeFiles:
    """Hard-link the weather file to `path` and return the files with that path.

    Raises:
        ForkFailed: the link cannot be created.
    """
    try:
        path.unlink(missing_ok=True)
        os.link(files.weather, path)
    except OSError as error:
        raise ForkFailed(file_error("a fork's weather", error)) from None
    return replace(files, weather=path)


def is_used(files: EpisodeFiles) -> bool:
    """Whether an engine has been started with these files; each engine has a folder of its own and removes it."""
    return not files.model.exists() or (files.model.parent / LOG).exists()


def create_fork_folder(folder: Path) -> Path:
    """Create the folder of a fork; raise `ForkFailed` if it cannot be created."""
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ForkFailed(file_error("a fork's files", error)) from None
    return folder


def file_error(files: str, error: OSError) -> str:
    """Return the error text for files that the node cannot write, or whose source it cannot read."""
    is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return f"the node {'has no room for' if is_full else 'cannot prepare'} {files}: {error}"
