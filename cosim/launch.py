"""The plants of a district's file as nodes: started in parallel, or found on their buses."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

from zenostat.bridge.client.local_node import LocalNode
from zenostat.cosim.binding import Binding, bind, is_building
from zenostat.cosim.coupled import GuardedPlant, RepeatedPlant
from zenostat.cosim.file import OWN_FIELDS, DistrictFile, OnLost, kind_of
from zenostat.cosim.market import Bids
from zenostat.cosim.market_plant import MarketPlant, market_manifest
from zenostat.cosim.node_plant import FoundPlant, NodePlant, StartedPlant
from zenostat.cosim.topology import Topology, check_file, resolve
from zenostat.topics.calendar import parse_day
from zenostat.topics.errors import (
    BusError,
    EngineDied,
    ForkFailed,
    InvalidConfig,
    SimulatorError,
    UsageError,
    ZenostatError,
)
from zenostat.topics.messages import DistrictMember, Manifest, Systems
from zenostat.topics.model_file import FileErrors

_DAY_S = 86400.0
_YEAR = 2017
"""For days without a year: one without 29 February, as most are."""
_PATHS = ("scenario", "config", "building", "weather", "faults", "alarms", "plant", "fmu", "grid")
"""Settings that may be paths, which are relative to the district's file."""
_SUFFIXES = (
    ".epjson", ".idf", ".osm", ".gbxml", ".xml", ".epw", ".csv", ".yaml", ".yml", ".json", ".fmu", ".py",
)  # fmt: skip
"""Suffixes of files, which names of buildings, weather files, scenarios and modules do not have."""


class PlantSet:
    """The plants of a district.

    Args:
        file: the district's file.

    Attributes:
        stop: set when the district is to end.
    """

    def __init__(self, file: DistrictFile) -> None:
        self.file = file
        self.stop = threading.Event()
        self._plants: dict[str, NodePlant | MarketPlant] = {}
        self._processes: list[LocalNode] = []
        self._lock = threading.Lock()

    def open(self) -> Binding:
        """Check the file, start or find all plants, and check the connections against their points.

        Raises:
            InvalidConfig: the file has errors; nothing was started if they do not depend on the plants' points.
            SimulatorError, BusError: a plant cannot be started, or is not there.
        """
        topology = check_file(self.file)
        settings = {name: self._settings(name) for name in self.file.spec.plants}
        try:
            manifests = self._open_all(settings)
            binding = bind(self.file, topology, manifests)
            self._check_copies(topology)
        except BaseException:
            self.close()
            raise
        return binding

    def systems(self) -> Systems:
        """Return the plants, and the electric grids among them; a node that does not describe its systems has none."""
        members, grids = [], []
        for name, plant in self._plants.items():
            spec = self.file.spec.plants[name]
            members.append(DistrictMember(name=name, kind=", ".join(kind_of(spec)), node=spec.node or ""))
            if isinstance(plant, NodePlant):
                with suppress(ZenostatError):
                    of_plant = plant.bus.systems(plant.node)
                    grids += [each.model_copy(update={"prefix": f"{name}.{each.prefix}"}) for each in of_plant.grids]
        return Systems(members=tuple(members), grids=tuple(grids))

    def _open_all(self, settings: Mapping[str, dict[str, Any]]) -> dict[str, Manifest]:
        """Open all plants at the same time; report the errors of all."""
        errors = self.file.errors()
        failures: list[Exception] = []
        markets = {name: p.market for name, p in self.file.spec.plants.items() if p.market is not None}
        nodes = {name: each for name, each in settings.items() if name not in markets}
        with ThreadPoolExecutor(max_workers=min(len(settings), 8)) as pool:
            futures = {name: pool.submit(self._open, name, each) for name, each in nodes.items()}
            try:
                for name, future in futures.items():
                    try:
                        self._plants[name] = future.result()
                    except UsageError as error:
                        errors.add(("plants", name), f"plant {name!r}: {error}")
                    except (SimulatorError, BusError) as error:
                        failures.append(type(error)(f"plant {name!r}: {error}"))
            except BaseException:  # such as a signal; a node that is starting raises an error once it is ended
                self.terminate()
                raise
        errors.raise_if_any()
        if failures:
            raise failures[0]
        manifests = {name: self._plants[name].manifest for name in nodes}
        step_s = None if self.file.spec.timestep is None else float(self.file.spec.timestep)
        for name, spec in markets.items():
            self._plants[name] = MarketPlant(market_manifest(name, spec, manifests, step_s), spec)
        self._plants = {name: self._plants[name] for name in settings}  # seeds depend on the order of the file
        return {name: plant.manifest for name, plant in self._plants.items()}

    def _open(self, name: str, settings: dict[str, Any]) -> NodePlant:
        spec = self.file.spec.plants[name]
        if spec.node is not None:
            keys = None if spec.keys is None else resolve(self.file, spec.keys)
            assert spec.connect is not None  # as `check_file` has checked
            return FoundPlant(spec.node, spec.connect, keys, f"district-{self.file.spec.name}"[:64])
        plant = StartedPlant(f"{self.file.spec.name}.{name}", settings, self._on_process)
        if self.stop.is_set():
            plant.close()
            raise EngineDied("the district ends")
        return plant

    def _on_process(self, process: LocalNode) -> None:
        with self._lock:
            self._processes.append(process)
            is_ending = self.stop.is_set()
        if is_ending:
            process.terminate()

    def terminate(self) -> None:
        """Let the processes of all plants end, without waiting for them; thread-safe."""
        self.stop.set()
        with self._lock:
            processes = [*self._processes]
        for process in processes:
            process.terminate()

    def _settings(self, name: str) -> dict[str, Any]:
        """Return the settings of a plant's node: those of the file, with absolute paths and the district's days."""
        spec, raw = self.file.spec, self.file.raw[name]
        settings = {key: value for key, value in raw.items() if key not in OWN_FIELDS and value is not None}
        for key in _PATHS:
            if key in settings:
                settings[key] = _absolute(self.file.path.parent, settings[key])
        if raw.get("district") is not None:
            settings["district"] = str(resolve(self.file, Path(raw["district"])).absolute())
        if is_building(raw) and spec.start is not None and not {"begin", "end"} & set(settings):
            settings |= self._days(name)
        return settings

    def _days(self, name: str) -> dict[str, str]:
        spec = self.file.spec
        assert spec.start is not None
        errors = self.file.errors()
        has_year = spec.start[4:5] == "-"
        try:
            first = parse_day(spec.start, "start", _YEAR)
        except InvalidConfig as error:
            errors.add(("start",), str(error))
        if spec.duration is None:
            errors.add(("start",), f"the last day of plant {name!r} follows from `duration`, which is missing")
        errors.raise_if_any()
        assert spec.duration is not None
        last = first + timedelta(days=-(-float(spec.duration) // _DAY_S) - 1)
        return {"begin": spec.start, "end": last.isoformat() if has_year else f"{last:%m-%d}"}

    def _check_copies(self, topology: Topology) -> None:
        """Try a copy of each plant of a solved loop, so that one that cannot be copied is reported at the start."""
        errors = self.file.errors()
        for block in topology.loops:
            for name in block.plants:
                location = self.file.connections[block.solved[0]].location
                text = f"loop {block.name!r} cannot be solved by trials"
                self._check_copy(name, location, text, "`delay: 1` in place of `solve`", errors)
        for name, spec in self.file.spec.plants.items():
            if spec.market is not None and spec.market.bids is Bids.TRIALS:
                for number, bidder in enumerate(spec.market.bidders):
                    location = ("plants", name, "market", "bidders", number)
                    text = f"the bids of {name!r} are trials"
                    self._check_copy(bidder.demand.partition(".")[0], location, text, "`bids: linear`", errors)
        errors.raise_if_any()

    def _check_copy(
        self, name: str, location: Sequence[str | int], text: str, alternative: str, errors: FileErrors
    ) -> None:
        try:
            self._plants[name].check_copy()
        except ForkFailed as error:
            errors.add(location, f"{text}: plant {name!r}: {error}; {alternative} needs no trials")

    def guarded(self, *, repeat: bool = False) -> dict[str, GuardedPlant]:
        """Return the plants with their reaction to a loss.

        Args:
            repeat: for the verification of a recording: those whose last values may hold are lost as they were there.
        """
        spec, guarded = self.file.spec, dict[str, GuardedPlant]()
        for name, plant in self._plants.items():
            on_lost = spec.plants[name].on_lost or spec.on_lost
            if repeat and on_lost is OnLost.GO_ON:
                guarded[name] = RepeatedPlant(name, plant, self.stop)
            else:
                timeout_s = float(spec.lost_timeout)
                guarded[name] = GuardedPlant(name, plant, on_lost, timeout_s=timeout_s, stop=self.stop)
            if isinstance(plant, NodePlant):
                plant.on_wait = guarded[name].report_obstacle
        return guarded

    def close(self) -> None:
        """End all nodes that were started, at the same time, and leave the others; idempotent."""
        self.terminate()
        for plant in self._plants.values():
            plant.close()
        with self._lock:
            processes, self._processes = self._processes, []
        for process in processes:
            process.close()


def _absolute(folder: Path, value: Any) -> Any:
    """Return a path as an absolute one; names, such as those of bundled buildings, and other values are unchanged."""
    if isinstance(value, list):
        return [_absolute(folder, item) for item in value]
    if not isinstance(value, str):
        return value
    place, colon, name = value.rpartition(":")
    if not colon:
        place, name = value, ""
    path = folder / Path(place).expanduser()
    is_path = path.suffix.lower() in _SUFFIXES or path.is_file()
    return f"{path.absolute()}{colon}{name}" if is_path else value


def input_files(file: DistrictFile) -> dict[str, Path]:
    """Return the files that a district's file names, by their roles, and the file itself."""
    files = {"district": file.path.absolute()}
    for name, raw in file.raw.items():
        for key in (*_PATHS, "district"):
            values = raw.get(key)
            for value in values if isinstance(values, list) else [values]:
                path = _absolute(file.path.parent, value) if isinstance(value, str) else ""
                place = path.rpartition(":")[0] if path.rpartition(":")[0].endswith(".py") else path
                if place and Path(place).is_absolute() and Path(place).is_file():
                    files[f"{key} of {name}"] = Path(place)
    return files
