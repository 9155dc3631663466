"""The specification of an EnergyPlus engine."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from zenostat.bridge.engine.spec import EngineProgram, EngineSpec
from zenostat.eplus_node.plan import Plan
from zenostat.models.building.diagnostics import suspects
from zenostat.models.building.model import Building
from zenostat.models.building.source_lines import locator
from zenostat.models.energyplus import ISOLATED
from zenostat.models.err_file import explain
from zenostat.models.points.schedules import scheduled_values
from zenostat.models.points.selection import Points
from zenostat.models.scenario.episode_weather import EpisodeFiles
from zenostat.topics.errors import ModelError


def _failure(building: Building | None, text: str, folder: Path) -> ModelError:
    return ModelError(f"{text}. {explain_end(building, folder, 'EnergyPlus gave no reason in eplusout.err')}")


def explain_end(building: Building | None, folder: Path, fallback: str) -> str:
    """Return why EnergyPlus ended: its messages, or the fallback, and the warnings on the model."""
    if building is None:
        return explain(folder, fallback)
    locate = locator(building.file) if building.file else None
    return "\n".join([explain(folder, fallback, locate=locate), *suspects(building)])


ENERGYPLUS = EngineProgram(
    command=(*ISOLATED, "zenostat.eplus_node.engine"),
    failure=partial(_failure, None),
    explain=partial(explain_end, None),
    # Huge pages mean fewer page tables for a fork to copy: a fork takes half the time (docs/performance.md).
    environment={"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"},
)


def engine_spec(plan: Plan, files: EpisodeFiles, folder: Path, **settings: Any) -> EngineSpec:
    """Return the specification of an engine for an episode.

    Args:
        plan: what it simulates.
        files: what it reads.
        folder: where it writes.
        settings: further fields of `EngineSpec`.
    """
    points = plan.points
    building = plan.building
    program = replace(ENERGYPLUS, failure=partial(_failure, building), explain=partial(explain_end, building))
    return EngineSpec(
        program=program,
        folder=folder,
        values=len(points.sensors) + len(points.meters),
        actuators=len(points.actuators),
        feedback=tuple(i for i, a in enumerate(points.actuators) if a.feedback),
        run={
            "model": str(files.model),
            "weather": str(files.weather),
            "steps": plan.period.steps,
            "steps_per_hour": plan.period.steps_per_hour,
            "shrink_caches": plan.config.shrink_caches,
            "scheduled": sorted(scheduled_values(points, plan.building, plan.period, files.weather).items()),
            **_point_fields(points),
        },
        **settings,
    )


def _point_fields(points: Points) -> dict[str, Any]:
    return {
        "sensors": [
            (s.variable, points.own_key(s), str(s.aggregation), system)
            for s, system in zip(points.sensors, points.system, strict=True)
        ],
        "meters": [
            (m.meter, [(part.name, part.index) for part in parts])
            for m, parts in zip(points.meters, points.meter_parts, strict=True)
        ],
        "actuators": [(a.component_type, a.control_type, points.own_key(a)) for a in points.actuators],
        "feedback": [(a.feedback, points.own_key(a)) for a in points.actuators if a.feedback],
    }
