"""Find EMS programs that call themselves: EnergyPlus crashes at them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from zenostat.models.building.findings import FieldFinding, Objects, RuleFinding, finding

_EMS = "EnergyManagementSystem:"
_RUN = re.compile(r"\s*RUN\s+(\w+)", re.IGNORECASE)


def program_findings(objects: Objects) -> Iterator[RuleFinding]:
    """Yield an error for each program or subroutine that is called and runs itself, also through others."""
    kinds, calls = dict[str, tuple[str, str]](), dict[str, dict[str, str]]()
    for kind in (f"{_EMS}Program", f"{_EMS}Subroutine"):
        for name, fields in objects.get(kind, {}).items():
            kinds[name.casefold()] = (kind, name)
            lines = [(f"lines[{i}].program_line", line) for i, line in enumerate(fields.get("lines", ()))]
            runs = [(path, _RUN.match(str(line.get("program_line", "")))) for path, line in lines]
            calls[name.casefold()] = {match[1].casefold(): path for path, match in runs if match}
    called = [
        str(entry.get("program_name", "")).casefold()
        for fields in objects.get(f"{_EMS}ProgramCallingManager", {}).values()
        for entry in fields.get("programs", ())
    ]
    for name in sorted(_reached(called, calls)):
        for callee, path in calls[name].items():
            if name in _reached([callee], calls):
                kind, spelled = kinds[name]
                text = f": {path} runs {kinds[callee][1]!r}, which runs {spelled!r}: EnergyPlus never ends it"
                text = f": {path} runs the program itself: EnergyPlus never ends it" if callee == name else text
                yield finding(kind, spelled, FieldFinding(path, text))


def _reached(names: list[str], calls: Mapping[str, Mapping[str, str]]) -> set[str]:
    """Return the programs of some names that exist, and those that they run."""
    reached, pending = set[str](), [name for name in names if name in calls]
    while pending:
        name = pending.pop()
        if name not in reached:
            reached.add(name)
            pending += [callee for callee in calls[name] if callee in calls]
    return reached
