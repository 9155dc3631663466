"""`zenostat model`: what a building model has, from its file alone."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict, is_dataclass
from dataclasses import fields as dataclass_fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.cli.console import err, out, print_error
from zenostat.cli.tables import AsJson, show, show_json
from zenostat.topics.atomic_file import atomic_file, check_writable
from zenostat.topics.errors import InvalidConfig, MissingExtra, ModelError, ZenostatError
from zenostat.topics.extras import requires_extra
from zenostat.topics.keys import check_name
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from zenostat.models.building.description import ModelDescription
    from zenostat.models.building.diagnostics import Diagnostic
    from zenostat.models.building.model import Building
    from zenostat.models.building.systems import System
    from zenostat.models.catalog import Entry
    from zenostat.models.semantic.points import Points

_VERSION = "EnergyPlus version of the file"
_RECORDING = ".mcap"
_ALIKE = 4
"""More components of one type on one level are shown as their number."""


def model(
    building: Annotated[
        str,
        typer.Argument(
            help="Short name, IDF or epJSON file, or part of a name; with --brick or --haystack, also a recording "
            "(`.mcap`)."
        ),
    ],
    html: Annotated[
        Path | None, typer.Option(help="Write a page with a 3D view to this .html file; it loads nothing.")
    ] = None,
    brick: Annotated[
        Path | None,
        typer.Option(
            help="Write the semantic model, a Brick graph with references to the points on the bus, to this .ttl file. "
            "Starts EnergyPlus for a moment, to list the points; those of a recording are in it."
        ),
    ] = None,
    haystack: Annotated[
        Path | None,
        typer.Option(
            help="Write the same entities in the tags of Project Haystack 4 to this .zinc, .trio or .json file."
        ),
    ] = None,
    node: Annotated[
        str | None,
        typer.Option(
            help="Name of the node that the references of --brick and --haystack are for. Default: building, or the "
            "recorded node."
        ),
    ] = None,
    probe: Annotated[
        str | None,
        typer.Option(
            metavar="WEATHER", help="Simulate days with this weather, and show what each default actuator changes."
        ),
    ] = None,
    begin: Annotated[str, typer.Option(help="First day that --probe simulates, MM-DD.")] = "07-03",
    end: Annotated[str, typer.Option(help="Last day that --probe simulates, MM-DD.")] = "07-07",
    as_json: AsJson = False,
) -> None:
    """Describe a building model: zones, systems, controls, schedules, actuators, errors.

    Example: `zenostat model office-medium --html office.html`

    Example: `zenostat model run.mcap --brick office.ttl`

    It simulates nothing without `--probe`.

    Exit codes: 0 without errors in the model, 1 with errors, 2 if the command cannot be run.
    """
    from zenostat.models import catalog
    from zenostat.models.building.description import describe_model, file_version

    if html is not None:
        _check_output("--html", html, (".html", ".htm"), "an .html file")
    semantic = _SemanticFiles(brick, haystack, node)
    if building.casefold().endswith(_RECORDING):
        semantic.write_recorded(Path(building), is_alone=html is None and probe is None and not as_json)
        return
    entry = catalog.find_building(building)
    read = _read(entry, as_json=as_json)
    description = describe_model(read, file_version(entry.path))
    if html is not None:
        _write_page(description, html)
    if not as_json:
        _print(description, notes_only=bool(semantic))
    failed = bool(_count_errors(description.file, description.diagnostics))
    further: dict[str, Any] = {}
    if not failed:
        semantic.write(read, building)
        if probe is not None:
            further = _probe({"building": building, "weather": probe, "begin": begin, "end": end}, as_json=as_json)
    if as_json:
        show_json(_as_json(description) | further)
    if failed:
        raise typer.Exit(1)


def _check_output(option: str, file: Path, suffixes: Collection[str], expected: str) -> None:
    if file.suffix.casefold() not in suffixes:
        raise InvalidConfig(f"{option} {file}: expected {expected}")
    check_writable(file, f"{option} {file}")


class _SemanticFiles:
    """The files of a semantic model.

    Args:
        brick: the Brick graph; None for none.
        haystack: the entities in the tags of Project Haystack; None for none.
        node: name of the node in the references; None for the default.

    Raises:
        InvalidConfig: another suffix, or an invalid name of the node.
        MissingExtra: a library is not installed.
    """

    def __init__(self, brick: Path | None, haystack: Path | None, node: str | None) -> None:
        self._brick, self._haystack, self._node = brick, haystack, node
        if brick is not None:
            _check_output("--brick", brick, (".ttl",), "a .ttl file")
            with requires_extra("semantic", "the semantic model", "rdflib"):
                import rdflib  # noqa: F401
        if haystack is not None:
            from zenostat.models.semantic.haystack import CODECS

            _check_output("--haystack", haystack, CODECS, "a .zinc, .trio or .json file")
        if node is not None and self:
            check_name(node, "the node's name")

    def __bool__(self) -> bool:
        return self._brick is not None or self._haystack is not None

    def write(self, read: Building, building: str) -> None:
        """Write the semantic model of a building with the points that a node has by default."""
        if not self:
            return
        from zenostat.eplus_node.config import read_config, scenario_of
        from zenostat.eplus_node.plan import run_points
        from zenostat.models import catalog

        weather = catalog.weathers()[0]
        with err.status(f"reading the points of {building} with EnergyPlus"):
            scenario = scenario_of(read_config({"building": building, "weather": weather.name}))
            points = run_points(read, scenario, weather.path, monitoring=True)
        self._write(read, self._node or "building", points)

    def write_recorded(self, recording: Path, *, is_alone: bool) -> None:
        """Write the semantic model of a recorded building with the recorded points.

        Raises:
            InvalidConfig: no file, or another option that needs more than a recording (not `is_alone`).
            InvalidRecording: it is no recording, or its model is missing or has changed.
        """
        if not self or not is_alone:
            raise InvalidConfig(
                f"{recording}: of a recording, only the semantic model is written: --brick FILE.ttl or --haystack "
                "FILE.zinc"
            )
        with requires_extra("recording", "a recording", "mcap and zstandard"):
            from zenostat.bridge.recording.reader import RecordingReader
            from zenostat.eplus_node.verify_recording import RecordedPlant

        with RecordingReader(recording) as reader:
            read = RecordedPlant(reader, exact=True).building()
            self._write(read, self._node or reader.manifest.node, reader.manifest)

    def _write(self, read: Building, node: str, points: Points) -> None:
        if self._brick is not None:
            from zenostat.agent_sdk.semantic import SemanticGraph
            from zenostat.models.semantic.graph import semantic_turtle

            model = SemanticGraph.parse(semantic_turtle(read, node, points))
            content = counted(len(model.graph), "statement", ",")
            _write_text(self._brick, model.turtle(), f"semantic model: {self._brick} ({content})")
        if self._haystack is not None:
            from zenostat.models.semantic.haystack import haystack_entities, haystack_text

            entities = haystack_entities(read, node, points)
            text = haystack_text(read.name, entities, self._haystack.suffix.casefold())
            content = counted(len(entities), "entity", ",")
            _write_text(self._haystack, text, f"semantic model: {self._haystack} ({content})")


def _write_text(file: Path, text: str, message: str) -> None:
    """Write a file, and report it."""
    with atomic_file(file) as temporary:
        temporary.write_text(text, encoding="utf-8")
    err.print(message)


def _read(entry: Entry, *, as_json: bool) -> Building:
    """Read a model; exit after showing its errors if it cannot be read."""
    from zenostat.models.building.model import read_building

    try:
        return read_building(entry)
    except MissingExtra:
        raise
    except (InvalidConfig, ModelError) as error:
        _show_unreadable(entry, error, as_json=as_json)
        raise typer.Exit(1) from None


def _show_unreadable(entry: Entry, error: ZenostatError, *, as_json: bool) -> None:
    """Show the errors of a file that cannot be read, in the form of a model's diagnostics."""
    from zenostat.models.building.description import file_version
    from zenostat.models.building.unreadable import diagnose_unreadable

    diagnostics, version = diagnose_unreadable(entry.path, error), file_version(entry.path)
    if as_json:
        facts = {"name": entry.name, "file": str(entry.path), "version": version}
        show_json({**facts, "diagnostics": [asdict(each) for each in diagnostics]})
    else:
        out.print(entry.name, style="bold")
        for term, text in (("File", str(entry.path)), (_VERSION, version or "none given")):
            out.print(f"{term}: {text}")
        for each in diagnostics:
            out.print(f"{each.severity}: {each}")
    _count_errors(str(entry.path), diagnostics)


def _count_errors(file: str, diagnostics: Sequence[Diagnostic]) -> int:
    """Return the number of errors, and report it if there are any."""
    count = sum(each.severity == "error" for each in diagnostics)
    if count:
        print_error(f"{file} has {counted(count, 'error')}")
    return count


def _probe(scenario: dict[str, str], *, as_json: bool) -> dict[str, Any]:
    """Probe a building; return its fields of the JSON, or show a table."""
    from zenostat.cli.probe import probe_fields, show_table
    from zenostat.lab.probe import probe

    report = probe(scenario)
    if as_json:
        return {"probe": probe_fields(report)}
    show_table(report, scenario["building"])
    return {}


def _as_json(description: ModelDescription) -> dict[str, Any]:
    fields = {field.name: getattr(description, field.name) for field in dataclass_fields(description)}
    geometry = fields.pop("geometry")
    data = {name: _plain(value) for name, value in fields.items()}
    surfaces = len(geometry.geometry.kinds) if geometry.geometry is not None else 0
    return data | {"surfaces": surfaces, "without_geometry": geometry.note}


def _plain(value: Any) -> Any:
    """Convert dataclasses, also those in tuples, to JSON built-ins."""
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def _facts(description: ModelDescription) -> list[tuple[str, str]]:
    summary = description.summary
    return [
        ("File", description.file),
        (_VERSION, description.version or "none given"),
        ("Converted", "; ".join(description.notes)),
        ("Floor area", f"{summary.floor_area_m2:,.0f} m², {summary.conditioned_area_m2:,.0f} m² conditioned"),
        ("Zones", f"{summary.zones}, {summary.conditioned_zones} conditioned"),
        ("Storeys", f"{len(description.storeys)}: {', '.join(f'{h:.4g}' for h in description.storeys)} m"),
        ("HVAC", summary.hvac),
        ("Fuels", ", ".join(summary.fuels)),
        ("Timesteps", f"{summary.steps_per_hour} per hour"),
        ("EMS programs", str(len(description.programs))),
    ]


def _notes(description: ModelDescription) -> list[str]:
    notes = [f"{each.severity}: {each}" for each in description.diagnostics]
    notes += [f"assumed: {text}" for text in description.assumptions]
    return notes + ([f"geometry: {description.geometry.note}"] if description.geometry.note else [])


def _tables(description: ModelDescription) -> Iterator[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
    yield (
        "Zones",
        ("zone", "storey", "area (m²)", "multiplier", "setpoint schedules", "air loops", "equipment"),
        [
            (
                zone.name if zone.is_conditioned else f"{zone.name} (unconditioned)",
                str(zone.storey + 1),
                f"{zone.area_m2:,.1f}",
                f"{zone.multiplier:g}",
                ", ".join(dict.fromkeys(zone.setpoints.values())),
                ", ".join(zone.air_loops),
                ", ".join(part.kind for part in zone.equipment),
            )
            for zone in description.zones
        ],
    )
    yield (
        "Thermostats and schedules that a controller can set",
        ("component type", "control type", "key", "acts on", "also set by"),
        [
            (each.component_type, each.control_type, each.key, each.acts_on, "; ".join(each.conflicts))
            for each in description.actuators
        ],
    )
    yield ("Setpoint managers", ("object",), [(text,) for text in description.setpoint_managers])
    yield ("Programs", ("object",), [(text,) for text in description.programs])
    unused = [each for each in description.schedules if not each.uses]
    yield ("Schedules that nothing uses", ("schedule", "type"), [(each.name, each.kind) for each in unused])


def _print(description: ModelDescription, *, notes_only: bool) -> None:
    if notes_only:
        for note in _notes(description):
            err.print(note)
    else:
        _show(description)


def _show(description: ModelDescription) -> None:
    out.print(description.name, style="bold")
    for term, text in _facts(description):
        if text:
            out.print(f"{term}: {text}")
    for note in _notes(description):
        out.print(note)
    for title, systems in (("Air loops", description.air_loops), ("Plant loops", description.plant_loops)):
        if systems:
            out.print(f"\n{title}", style="bold")
        for system in systems:
            _show_system(system, 1)
    for title, columns, rows in _tables(description):
        if rows:
            out.print(f"\n{title}", style="bold")
            show("", columns, rows, right=("area (m²)", "multiplier"), wrap=columns)


def _show_system(system: System, depth: int) -> None:
    _line(f"{system.name} ({system.kind})" if system.kind else system.name, depth)
    by_kind: dict[str, list[System]] = {}
    for part in system.parts:
        by_kind.setdefault(part.kind, []).append(part)
    for kind, members in by_kind.items():
        if kind and kind != "Zone" and len(members) > _ALIKE:
            _line(f"{len(members)} {kind}: {members[0].name}, …, {members[-1].name}", depth + 1)
        else:
            for member in members:
                _show_system(member, depth + 1)


def _line(text: str, depth: int) -> None:
    out.print(f"{'  ' * depth}{text}")


def _write_page(description: ModelDescription, path: Path) -> None:
    from zenostat.views.report.model_page import model_page

    trees: Sequence[tuple[str, Sequence[System]]] = (
        ("Air loops", description.air_loops),
        ("Plant loops", description.plant_loops),
    )
    text = model_page(
        description.name,
        _facts(description),
        description.geometry.geometry,
        _notes(description),
        trees,
        list(_tables(description)),
    )
    _write_text(path, text, f"page: {path}")
