"""EnergyPlus as a plant: engines that simulate a building, one per slot."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.engine.group import EngineGroup
from zenostat.bridge.engine.lists import close_all, start_all
from zenostat.bridge.engine.spec import EngineSpec
from zenostat.bridge.node.plant import PlantContext, PlantDescription, RunningPlant, Site, WeatherTable
from zenostat.eplus_node.engine_pool import EnginePool, EpisodeWeather
from zenostat.eplus_node.episode_folders import create_fork_folder, link_weather
from zenostat.eplus_node.fork_template import EngineTemplate
from zenostat.eplus_node.plan import Plan, describe
from zenostat.models.scenario.episode_weather import WeatherDraw, WeatherSource, series
from zenostat.models.weather.epw import find_column
from zenostat.topics.errors import InvalidRecording, SimulatorError
from zenostat.topics.messages import EngineStart, EpisodeStart

_FAST_STARTS = (EngineStart.FORKED, EngineStart.PREFETCHED, EngineStart.REUSED)


class EnergyPlusEngines(EngineGroup):
    """Running EnergyPlus engines: of a node, a snapshot or a branch.

    Args:
        plan: what they simulate.
        description: of the building and its points.
        cpus: cores on which forks may run; empty leaves them to the system.
    """

    def __init__(self, plan: Plan, description: PlantDescription, cpus: tuple[int, ...]) -> None:
        super().__init__(len(plan.points.actuators))
        self.description = description
        self._plan, self._fork_cpus = plan, cpus
        self._numbers = itertools.count(1)

    def weather_of(self, slot: int) -> EpisodeWeather:
        """Return the weather of the present episode of a slot."""
        raise NotImplementedError

    def _source(self, slot: int) -> WeatherSource:
        return self._plan.sources[self.weather_of(slot).draw.source]

    def site(self, slot: int) -> Site:
        """Return the weather file of a slot, and its location."""
        source = self._source(slot)
        header = source.header
        return Site(source.name, header.place, header.latitude_deg, header.longitude_deg, header.time_zone_h)

    def notes(self, slot: int) -> list[str]:
        """Return the weather file, the origin of its design days, conversions of the model, and the weather noise."""
        source, files = self._source(slot), self.weather_of(slot).files
        design_days = [source.site.source] if source.site is not None else []
        noise = [f"{name} {value:.4g}" for name, value in files.noise_parameters.items()]
        return [source.name, *design_days, *self._plan.building.notes, *noise]

    def weather(self, slot: int, columns: Sequence[str]) -> WeatherTable:
        """Return columns of the weather file of a slot's present episode."""
        values, step_s = series(self.weather_of(slot).files.weather, self._plan.period, columns)
        selected = [find_column(name) for name in columns]
        return WeatherTable([column.name for column in selected], [column.unit for column in selected], step_s, values)

    def fork(self, slots: Sequence[int], folder: Path, *, baseline: bool = False) -> EnergyPlusFork:
        """Fork the engines of some slots; see `RunningPlant.fork`."""
        return self._copy(slots, folder, self.members(slots, baseline=baseline), ())

    def fork_with_error(self, slots: Sequence[int], folder: Path, forecast_error: Sequence[float]) -> EnergyPlusFork:
        """Fork the engines of some slots into a forecast with errors; see `ForecastPlant.fork_with_error`."""
        return self._copy(slots, folder, self.members(slots, baseline=False), forecast_error)

    def _copy(
        self, slots: Sequence[int], folder: Path, members: Sequence[EngineClient], forecast_error: Sequence[float]
    ) -> EnergyPlusFork:
        create_fork_folder(folder)
        # Linked before the fork: a failure after it would leave engines behind.
        links = {slot: self._link(self.weather_of(slot), folder / f"slot-{slot}.epw") for slot in set(slots)}
        forks = self._fork_all(members, folder, forecast_error)
        copy = EnergyPlusFork(self._plan, self.description, self._fork_cpus, [links[slot] for slot in slots])
        copy.adopt(forks, self, slots)
        return copy

    def _link(self, weather: EpisodeWeather, path: Path) -> EpisodeWeather:
        """Hard-link the weather of an episode, unless its file is kept in any case."""
        is_kept = self._plan.config.output_dir is not None
        if is_kept or weather.files.weather == self._plan.sources[weather.draw.source].path:
            return weather
        return EpisodeWeather(weather.draw, link_weather(weather.files, path))

    def _fork(self, client: EngineClient, folder: Path) -> EngineClient:
        (child,) = self._fork_all([client], folder)
        return child

    def _fork_all(
        self, clients: Sequence[EngineClient], folder: Path, forecast_error: Sequence[float] = ()
    ) -> list[EngineClient]:
        """Fork each engine as often as it is listed."""
        forks: list[EngineClient] = []
        try:
            for client, group in itertools.groupby(clients):
                forks += client.fork_all([self._fork_spec(client, folder, forecast_error) for _ in group])
            for fork in forks:
                fork.receive()
        except BaseException:
            close_all(forks)
            raise
        return forks

    def _fork_spec(self, client: EngineClient, folder: Path, forecast_error: Sequence[float]) -> EngineSpec:
        return replace(
            client.spec,
            folder=create_fork_folder(folder / str(next(self._numbers))),
            keep_output=False,
            cpus=self._fork_cpus,
            poll=False,
            branch=True,
            replaced_file=None,
            forecast_error=tuple(forecast_error),
        )


class EnergyPlusFork(EnergyPlusEngines):
    """Forked engines of a snapshot or a branch.

    Args:
        plan, description, cpus: as of `EnergyPlusEngines`.
        weather: of each slot.
    """

    def __init__(
        self, plan: Plan, description: PlantDescription, cpus: tuple[int, ...], weather: Sequence[EpisodeWeather]
    ) -> None:
        super().__init__(plan, description, cpus)
        self._weather = [*weather]

    def weather_of(self, slot: int) -> EpisodeWeather:
        """Return the weather of the episode that was forked."""
        return self._weather[slot]


class EnergyPlusPlant(EnergyPlusEngines):
    """The EnergyPlus engines of a node; implements `zenostat.bridge.node.plant.Plant`.

    Args:
        plan: what they simulate.
        context: folder, cores and registry of the node.
    """

    def __init__(self, plan: Plan, context: PlantContext) -> None:
        super().__init__(plan, describe(plan), context.cpus)
        self._folder, self._registry, self._has_baseline = context.folder, context.registry, context.baseline
        templates, is_single = [EngineTemplate() for _ in plan.sources], context.slots == 1
        self._pools = [
            EnginePool(
                plan,
                context.folder,
                templates,
                subfolder="" if is_single else f"slot-{slot}",
                cpus=placement.cpus,
                spare=placement.spare,
                poll=placement.poll,
                registry=context.registry,
            )
            for slot, placement in enumerate(context.placement)
        ]
        self._episode = [0] * context.slots
        self._starts = [EngineStart.STARTED] * context.slots
        self._started: Sequence[int] = ()
        self._replaced: list[EngineClient] = []

    def weather_of(self, slot: int) -> EpisodeWeather:
        """Return the weather of the present episode of a slot."""
        return self._pools[slot].weather

    # Episodes

    def next_episode(
        self, slots: Sequence[int], seeds: Sequence[int | None], episode: Sequence[int], untouched: Sequence[bool]
    ) -> list[EpisodeStart]:
        """Draw the weather of the next episode of some slots; see `Plant.next_episode`."""
        self._episode = [*episode]
        for slot, seed, is_untouched in zip(slots, seeds, untouched, strict=True):
            waiting = self.members([slot], baseline=True) if is_untouched else []
            self._starts[slot] = self._pools[slot].next_episode(seed, episode[slot], untouched=waiting)
        return self._episode_starts(slots)

    def episode_inputs(self, slot: int) -> dict[str, Any]:
        """Return the weather file and the seed of its noise; see `RepeatablePlant.episode_inputs`."""
        draw = self.weather_of(slot).draw
        return {"source": draw.source, "noise": draw.noise}

    def repeat_episode(self, slots: Sequence[int], inputs: Sequence[Mapping[str, Any]], episode: Sequence[int]) -> None:
        """Choose the weather of a recorded episode; see `RepeatablePlant.repeat_episode`."""
        self._episode = [*episode]
        for slot, fields in zip(slots, inputs, strict=True):
            try:
                draw = WeatherDraw(int(fields["source"]), int(fields["noise"]))
            except (KeyError, TypeError, ValueError):
                raise InvalidRecording(f"an episode of EnergyPlus has a source and a noise, not {fields}") from None
            self._starts[slot] = self._pools[slot].repeat_episode(draw, episode[slot])

    def _episode_starts(self, slots: Sequence[int]) -> list[EpisodeStart]:
        return [
            EpisodeStart(
                engine_start=self._starts[slot],
                weather=self._source(slot).name,
                noise_parameters=self.weather_of(slot).files.noise_parameters,
                output_dir=self._pools[slot].output_dir,
            )
            for slot in slots
        ]

    def start(self, slots: Sequence[int]) -> None:
        """Bring the engines of some slots to sample 0; see `Plant.start`."""
        clients, self._started = self.clients, slots
        is_first = not clients
        replaced = [slot for slot in slots if is_first or not self._continues(slot)]
        previous = [] if is_first else [clients[slot] for slot in replaced]
        # Ending the previous engines takes as long as a fork, so a fast start goes first.
        is_fast = all(self._starts[slot] in _FAST_STARTS for slot in slots)
        try:
            if not is_fast:
                _end(previous)
            for slot in replaced:  # all at once, before the first one is waited for
                self._pools[slot].start()
            started = start_all(replaced, lambda slot: self._pools[slot].engine(self._episode[slot]))
            if is_first:
                self.clients = started
            for slot, client in zip(replaced, started, strict=True):
                self.clients[slot] = client
            self._fork_baselines(replaced)
        except SimulatorError:
            _end(previous)
            raise
        self._replaced = previous if is_fast else []
        self.begin(slots)

    def _continues(self, slot: int) -> bool:
        """Return whether the engine of the previous episode waits at sample 0, unused."""
        return self._starts[slot] is EngineStart.REUSED and self.clients[slot].alive

    def _fork_baselines(self, slots: Sequence[int]) -> None:
        if not self._has_baseline:
            return
        folder = self._folder / "baseline"
        forks = start_all(slots, lambda slot: self._fork(self.clients[slot], folder))
        if not self.baselines:
            self.baselines = forks
            return
        for slot, client in zip(slots, forks, strict=True):
            self.baselines[slot].close()
            self.baselines[slot] = client

    def restore(self, saved: RunningPlant, episode: Sequence[int]) -> list[EpisodeStart]:
        """Continue from a snapshot; see `Plant.restore`."""
        assert isinstance(saved, EnergyPlusFork)
        self._episode = [*episode]
        slots = range(len(self._pools))
        weather = [
            self._link(saved.weather_of(slot), self._pools[slot].restored_weather(episode[slot])) for slot in slots
        ]
        calls = [
            *(partial(self._pools[slot].fork, saved.clients[slot], episode[slot]) for slot in slots),
            *(partial(self._fork, client, self._folder / "baseline") for client in saved.baselines),
        ]
        forks = start_all(calls, lambda call: call())
        for pool, linked in zip(self._pools, weather, strict=True):
            pool.restore(linked)
        self._replaced, self._started = self.all, ()
        self.adopt(forks, saved, slots)
        self._starts = [EngineStart.SNAPSHOT] * len(slots)
        return self._episode_starts(slots)

    def clean_up(self) -> None:
        """End the engines that were replaced, and start those of the next episodes where the weather differs."""
        self._end_replaced()
        for slot in self._started:
            self._pools[slot].prefetch(self._episode[slot])

    def drain_warnings(self) -> list[str]:
        """Return warnings about engines that were replaced, since the last call."""
        warnings = [warning for pool in self._pools for warning in pool.warnings]
        for pool in self._pools:
            pool.warnings.clear()
        return warnings

    # End

    def interrupt(self) -> None:
        """Kill all engines, also those that are starting; thread-safe. No more engines start."""
        self._registry.interrupt()

    def close(self) -> None:
        """End all engines, also those that wait for an episode; idempotent."""
        self._end_replaced()
        self.end()
        for pool in self._pools:
            pool.close()

    def _end_replaced(self) -> None:
        replaced, self._replaced = self._replaced, []
        _end(replaced)


def _end(clients: Sequence[EngineClient]) -> None:
    for client in clients:
        client.end(failed=False)
