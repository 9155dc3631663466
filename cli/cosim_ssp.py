"""`zenostat cosim --from system.ssp`: the file of a district from an SSP file."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from dataclasses import replace
from math import isclose, isfinite
from pathlib import Path
from typing import Any

from zenostat.cli.console import err, out
from zenostat.cli.options import Loops
from zenostat.cosim.file import RESERVED, read_district
from zenostat.cosim.graph import feedback_edges
from zenostat.cosim.resampling import TICK_S, whole_steps
from zenostat.cosim.topology import MAX_NAME
from zenostat.plants.ssp.structure import Link, Structure, read_structure
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.yaml12 import dump

_TOLERANCE = 1e-3


def convert(source: Path, target: Path, loops: Loops, *, overwrite: bool, step_s: float | None = None) -> None:
    """Write the file of a district, and its FMUs into a folder beside it that has its name.

    Args:
        source: the SSP file.
        target: the file to write.
        loops: treatment of loops.
        overwrite: whether an existing file and its folder are replaced.
        step_s: timestep of the district in s; None: the step size that the SSP file names, else that of each FMU.

    Raises:
        InvalidConfig: the SSP file cannot be used, the target exists, or `step_s` is not above 0.
    """
    if step_s is not None and not (isfinite(step_s) and step_s > 0.0):
        raise InvalidConfig(f"--step {step_s:g}: a number of seconds above 0 expected")
    if target.suffix not in (".yaml", ".yml"):
        raise InvalidConfig(f"{target}: name a file that ends in .yaml, for the district of {source}")
    folder = target.with_suffix("")
    _check_target(target, folder, overwrite=overwrite)
    work = folder.with_name(f".{folder.name}.new")
    shutil.rmtree(work, ignore_errors=True)
    try:
        structure = read_structure(source, work, RESERVED)
        if step_s is not None:
            structure = replace(structure, step_s=step_s)
        if folder.exists():
            shutil.rmtree(folder)
        work.rename(folder)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    target.write_text(dump(district(structure, folder.name, loops, source.name)), encoding="utf-8")
    read_district(target)
    notes = list(structure.notes)
    duration_s, own_s = _duration_s(structure), _experiment_s(structure)
    if duration_s is not None and own_s is not None and not isclose(duration_s, own_s, abs_tol=TICK_S):
        notes.append(
            f"the experiment's {own_s:g} s are not a multiple of the step size {structure.step_s:g} s; an episode has "
            f"{duration_s:g} s"
        )
    if structure.step_s is None:
        notes.append(
            "the SSP file names no step size, so each FMU has that of its model description, or else 500 to 1,000 "
            "steps in its episode; to set one for all: --step 60"
        )
    for note in notes:
        err.print(f"note: {note}", style="yellow")
    plants, links = len(structure.components), len(structure.links)
    out.print(f"{target}: FMUs: {plants}, connections: {links}; check it with: zenostat cosim {target} --check")


def _check_target(target: Path, folder: Path, *, overwrite: bool) -> None:
    """Refuse a target that exists, and with `overwrite` one whose folder was not made by an earlier conversion."""
    existing = [path for path in (target, folder) if path.exists()]
    if existing and not overwrite:
        raise InvalidConfig(f"{existing[0]} exists; choose another name, or --overwrite")
    if not folder.exists():
        return
    others = [path for path in folder.iterdir() if path.suffix != ".fmu"] if folder.is_dir() else [folder]
    if others or not target.exists():
        reason = f"it has {others[0].name}" if others else f"there is no {target.name} beside it"
        raise InvalidConfig(
            f"{folder} is not of an earlier conversion ({reason}) and is not replaced; choose another name"
        )


def district(structure: Structure, folder: str, loops: Loops, source: str) -> dict[str, Any]:
    """Return the content of a district's file.

    Args:
        structure: what the SSP file has.
        folder: of the FMUs, beside the district's file.
        loops: treatment of loops.
        source: name of the SSP file.
    """
    name = re.sub(r"[^A-Za-z0-9_\-]", "_", structure.name or "")[:64].strip("-_") or "district"
    content: dict[str, Any] = {"name": name, "about": f"From {source}."}
    experiment: dict[str, Any] = {}
    if structure.step_s is not None:
        content["timestep"] = experiment["step_s"] = structure.step_s
    if structure.start_s:
        experiment["start_s"] = structure.start_s
    if (duration_s := _duration_s(structure)) is not None:
        experiment["duration_s"] = duration_s
    content["plants"] = {}
    for component in structure.components:
        arguments = dict(experiment)
        if component.interface:
            arguments["interface"] = component.interface
        if component.starts:
            arguments["set"] = dict(component.starts)
        content["plants"][component.name] = {"fmu": f"{folder}/{component.file.name}"}
        if arguments:
            content["plants"][component.name]["plant_arguments"] = arguments
    edges = [(link.source.partition(".")[0], link.target.partition(".")[0]) for link in structure.links]
    back = set(feedback_edges(content["plants"], edges))
    connections = [
        _connection(number, link, loops if number in back else None) for number, link in enumerate(structure.links)
    ]
    return content | ({"connections": connections} if connections else {})


def _duration_s(structure: Structure) -> float | None:
    """Return the length of an episode in whole timesteps, at least one; None if the SSP file does not say."""
    length_s = _experiment_s(structure)
    if length_s is None or structure.step_s is None:
        return length_s
    return round(max(1, whole_steps(length_s, structure.step_s)) * structure.step_s, 6)


def _experiment_s(structure: Structure) -> float | None:
    length_s = 0.0 if structure.stop_s is None else structure.stop_s - (structure.start_s or 0.0)
    return length_s if length_s > 0.0 else None


def _connection(number: int, link: Link, loops: Loops | None) -> Mapping[str, Any]:
    entry: dict[str, Any] = {"from": link.source, "to": link.target}
    if len(f"{link.source}-{link.target}") > MAX_NAME:  # its name by default
        entry = {"name": f"connection_{number + 1}", **entry}
    if link.unit:
        entry["unit"] = link.unit
    if link.factor != 1.0:
        entry["factor"] = link.factor
    if link.offset:
        entry["offset"] = link.offset
    if loops is Loops.SOLVE:
        entry |= {"solve": True, "tolerance": _TOLERANCE}
    elif loops is Loops.DELAY:
        entry["delay"] = 1
    return entry
