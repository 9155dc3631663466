"""Answers about scenarios for the builder of the control room, as a program: `python -m zenostat.cli.scenario_answers`.

Standard input has a question in each line as JSON, standard output its answer. The program ends with its standard
input. Questions come from browsers, so they are data: a scenario of theirs chooses no code, and names files in the
folder of the first argument only; without one, it names none.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from functools import lru_cache
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any

from zenostat.bridge.runtime.scratch import scratch_folder
from zenostat.cli.scenarios import plan_scenario, scenario_schema
from zenostat.models import catalog, data_packs
from zenostat.models.building.external_files import FILE_FIELDS
from zenostat.models.scenario.schema import load_yaml, resolve_paths
from zenostat.topics import yaml12
from zenostat.topics.errors import ErrorCollector, InvalidConfig, SimulatorError, UnknownName, UsageError, to_wire
from zenostat.topics.keys import is_name
from zenostat.topics.plurals import counted
from zenostat.topics.user_file import user_file

MAX_LISTED = 200
"""Largest number of points in an answer."""

_MAX_FILES = 2000
_PROGRAM_TYPES = ("pythonplugin:", "externalinterface")
_FILE_TYPES = {kind.casefold() for kind in FILE_FIELDS}


class ScenarioAnswers:
    """Answers to the questions of a scenario builder.

    Args:
        folder: of scenario files, and of the models and weather files that scenarios may name; None for none.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = None if folder is None else folder.resolve()

    def answer(self, question: Mapping[str, Any]) -> Any:
        """Return the answer to a question: its name as `ask`, and its arguments.

        Raises:
            ZenostatError: the question cannot be answered; the text says why.
        """
        answers: dict[str, Callable[..., Any]] = {
            "form": self.form,
            "points": self.points,
            "read": self.read,
            "check": self.check,
        }
        arguments = dict(question)
        return answers[arguments.pop("ask")](**arguments)

    def form(self) -> dict[str, Any]:
        """Return the schema of scenarios, and the names that a form offers: buildings, weather files and scenarios."""
        schema, files = scenario_schema(), self._files((".yaml",))
        del schema["properties"]["wrappers"]
        return {
            "schema": schema,
            "buildings": [entry.name for entry in catalog.buildings()],
            "weathers": [entry.name for entry in catalog.weathers()],
            "own_buildings": [*self._files(catalog.MODEL_SUFFIXES)],
            "own_weathers": [*self._files(catalog.WEATHER_SUFFIXES)],
            "scenarios": sorted(name for file in files if is_name(name := file.removesuffix(".yaml")) and name != file),
        }

    def _files(self, suffixes: tuple[str, ...]) -> Iterator[str]:
        """Yield the files in the folder with some suffixes, without those that are hidden or lead elsewhere."""
        if self._folder is None:
            return
        for number, path in enumerate(sorted(self._folder.rglob("*"))):
            if number >= _MAX_FILES:
                return
            name = path.relative_to(self._folder)
            is_hidden = any(part.startswith(".") for part in name.parts)
            if path.suffix.lower() in suffixes and not is_hidden and path.is_file() and self._is_inside(path):
                yield name.as_posix()

    def points(self, building: str, search: str = "", kind: str = "", *, default: bool = False) -> dict[str, Any]:
        """Return the points of a building whose texts contain all words of a search.

        Args:
            building: as in a scenario.
            search: words in any order.
            kind: only `sensor`, `meter` or `actuator`.
            default: only those that a node has by default, with their names on the bus.
        """
        self._check_path("building", building, catalog.MODEL_SUFFIXES)
        entry = catalog.find_building(self._absolute(building))
        rows = _points(entry, entry.path.stat().st_mtime_ns, default)
        words = search.casefold().split()
        kinds = (kind,) if kind else ("sensor", "meter", "actuator")
        listed = [row for row in rows if row["kind"] in kinds and all(word in row["text"] for word in words)]
        shown = [{name: value for name, value in row.items() if name != "text"} for row in listed[:MAX_LISTED]]
        return {"building": entry.name, "total": len(rows), "count": len(listed), "points": shown}

    def read(self, name: str) -> dict[str, Any]:
        """Return the fields of a scenario file in the folder, and the file's digest.

        Raises:
            UnknownName: there is no such file.
            InvalidConfig: it is not YAML, or has numbers that are not finite, which no page can show.
        """
        path = None if self._folder is None or not is_name(name) else self._folder / f"{name}.yaml"
        if path is None or not self._is_inside(path):
            raise UnknownName(f"there is no scenario {name!r} in the folder of scenarios")
        with user_file(path, UnknownName):
            digest = sha256(path.read_bytes()).hexdigest()  # first, so that a change from here on is noticed
        fields = load_yaml(path)
        if problems := [*_not_finite(fields)]:
            raise InvalidConfig("\n".join(f"{path.name}: {problem}" for problem in problems))
        return {"fields": fields, "digest": digest}

    def check(self, fields: Mapping[str, Any], name: str = "scenario") -> dict[str, Any]:
        """Return a scenario as YAML, with the errors that `zenostat scenarios check` reports.

        `is_refused`: it is empty, more than data, or names files outside of the folder, and shall not be saved either.

        Args:
            fields: of the scenario; relative paths are relative to the folder.
            name: of its file, without `.yaml`.
        """
        text = yaml12.dump(dict(fields)) if fields else ""
        answer: dict[str, Any] = {"yaml": text, "errors": [], "warnings": [], "summary": "", "is_refused": not fields}
        try:
            self._check_data(fields)
        except (UsageError, SimulatorError) as error:
            return answer | {"errors": str(error).split("\n"), "is_refused": True}
        try:
            planned = self._plan(fields, name)
        except (UsageError, SimulatorError) as error:
            return answer | {"errors": str(error).split("\n")}
        points = planned.points
        summary = (
            f"{planned.building.name}, {', '.join(source.name for source in planned.sources)}, "
            f"{counted(planned.period.steps, 'timestep')}; {counted(len(points.sensors), 'sensor')}, "
            f"{counted(len(points.meters), 'meter')}, {counted(len(planned.task.actions), 'action')}"
        )
        return answer | {"summary": summary, "warnings": [*planned.warnings]}

    def _plan(self, fields: Mapping[str, Any], name: str) -> Any:
        """Return the plan of a scenario; errors name its file as the command line does in the file's folder."""
        with scratch_folder() as folder:
            path = folder / f"{name}.yaml"
            path.write_text(yaml12.dump(resolve_paths(fields, self._folder or folder)), encoding="utf-8")
            try:
                return plan_scenario({"scenario": str(path)})
            except (UsageError, SimulatorError) as error:
                raise type(error)(str(error).replace(str(path), path.name)) from None

    # What a scenario of a stranger may name

    def _check_data(self, fields: Mapping[str, Any]) -> None:
        """Raise `InvalidConfig` for what chooses code, files outside of the folder, and numbers that are not finite."""
        errors = ErrorCollector()
        errors.errors += map(InvalidConfig, _not_finite(fields))
        if "wrappers" in fields:
            errors.errors.append(
                InvalidConfig("wrappers: not from a browser, since they can name code; add them to the saved file")
            )
        for field, suffixes in (("building", catalog.MODEL_SUFFIXES), ("weather", catalog.WEATHER_SUFFIXES)):
            value = fields.get(field)
            for text in value if isinstance(value, list) else [value]:
                errors.collect(lambda field=field, text=text, kinds=suffixes: self._check_path(field, text, kinds))  # type: ignore[misc]
        for text in _tables(fields.get("reward")):
            errors.collect(lambda text=text: self._check_file("reward", text))  # type: ignore[misc]
        edits = fields.get("edits")
        for kind in edits if isinstance(edits, Mapping) else ():
            if kind.casefold() in _FILE_TYPES or kind.casefold().startswith(_PROGRAM_TYPES):
                errors.errors.append(
                    InvalidConfig(
                        f"edits: {kind}: not from a browser, since it names files or programs; edit the model"
                    )
                )
        errors.raise_if_any()

    def _check_path(self, field: str, text: Any, suffixes: tuple[str, ...]) -> None:
        """Check a building or a weather file: a listed name, or a file in the folder."""
        if not isinstance(text, str):
            return  # the schema's error is better
        is_file = Path(text).suffix.lower() in suffixes
        pack, _, rest = text.partition("/")
        if is_file or text.startswith("~") or ("/" in text and (pack not in data_packs.PACKS or "/" in rest)):
            self._check_file(field, text)

    def _check_file(self, field: str, text: str) -> None:
        if self._folder is None:
            raise InvalidConfig(
                f"{field}: {text}: files need a folder that contains them: zenostat room --scenarios FOLDER"
            )
        if text.startswith("~") or not self._is_inside(self._folder / text):
            raise InvalidConfig(f"{field}: {text} is not in the folder of scenarios; name a file in it")

    def _is_inside(self, path: Path) -> bool:
        """Return whether a path leads into the folder, its links followed."""
        try:
            return self._folder is not None and path.resolve().is_relative_to(self._folder)
        except (OSError, ValueError, RuntimeError):  # no path at all, or a circle of links
            return False

    def _absolute(self, building: str) -> str:
        return str(resolve_paths({"building": building}, self._folder or Path("/nonexistent"))["building"])


def _not_finite(value: Any, path: tuple[Any, ...] = ()) -> Iterator[str]:
    """Yield the problem of each number that is not finite, with the path of its field."""
    if isinstance(value, float) and not isfinite(value):
        yield f"{'.'.join(map(str, path))}: a finite number expected, not {value}"
    elif isinstance(value, Mapping | list):
        for key, each in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from _not_finite(each, (*path, key))


def _tables(reward: Any) -> Iterator[str]:
    """Yield the files of time series in a reward."""
    if isinstance(reward, Mapping):
        if isinstance(text := reward.get("csv"), str):
            yield text
        for value in reward.values():
            yield from _tables(value)
    elif isinstance(reward, list):
        for value in reward:
            yield from _tables(value)


@lru_cache(maxsize=4)
def _points(entry: catalog.Entry, _changed_ns: int, default: bool) -> list[dict[str, Any]]:
    """Return the points of a building as JSON values, with a text to search in."""
    from zenostat.cli.points import points_of_run
    from zenostat.models.building.model import read_building
    from zenostat.models.points.discovery import discover
    from zenostat.models.points.listing import listing

    model = read_building(entry)
    if default:
        rows = points_of_run(str(entry.path), model, default=True, monitoring=False)
    else:
        rows = [*listing(discover(model, catalog.weathers()[0].path), model)]
    texts = (" ".join((row.bus_name, row.name, row.key, row.where)).casefold() for row in rows)
    return [asdict(row) | {"text": text} for row, text in zip(rows, texts, strict=True)]


def main(arguments: list[str]) -> None:
    """Answer the questions of standard input."""
    answers = ScenarioAnswers(Path(arguments[0]) if arguments else None)
    output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is no answer
    for line in sys.stdin:
        try:
            content: dict[str, Any] = {"answer": answers.answer(json.loads(line))}
        except Exception as error:  # of any question: the next one is answered
            content = to_wire(error)
        output.write(json.dumps(content) + "\n")
        output.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
