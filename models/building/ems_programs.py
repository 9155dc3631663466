"""Find EMS programs that EnergyPlus does not accept, and those that it never ends or crashes at.

The rules were determined by experiment with EnergyPlus 25.2 (`tests/models/test_ems_programs.py` compares them with
its exit codes). It parses all programs, called or not; IF and WHILE are counted apart from each other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from zenostat.models.building.findings import FieldFinding, RuleFinding, finding
from zenostat.models.input_format.source_model import ModelObjects
from zenostat.topics.errors import did_you_mean

_EMS = "EnergyManagementSystem:"
_RUN = re.compile(r"\s*RUN\s+(\w+)", re.IGNORECASE)

_NEEDS_EXPRESSION = ("IF", "ELSEIF", "WHILE")
_STANDS_ALONE = ("ELSE", "ENDIF", "ENDWHILE")
_KEYWORDS = ("SET", "RUN", "RETURN", *_NEEDS_EXPRESSION, *_STANDS_ALONE)
_MOST_IFS = 5

_OPERATORS = re.compile(r"==|<=|>=|<>|&&|\|\|")
_UNEXPECTED = re.compile(r"[=&|!]")
_FUNCTION = re.compile(r"@\s*(\w*)")

_DAYS = ("Today", "Tomorrow")
_WEATHER = """
Albedo BeamSolarRad DifSolarRad HorizIRSky IsRain IsSnow LiquidPrecip OutBaroPress OutDewPointTemp OutDryBulbTemp
OutRelHum SkyTemp WindDir WindSpeed
"""
_OTHERS = """
Round Mod Sin Cos ArcSin ArcCos DegToRad RadToDeg Exp Ln Max Min Abs RandomUniform RandomNormal SeedRandom
RhoAirFnPbTdbW CpAirFnW HfgAirFnWTdb HgAirFnWTdb TdpFnTdbTwbPb TdpFnWPb HFnTdbW HFnTdbRhPb TdbFnHW RhovFnTdbRh
RhovFnTdbRhLBnd0C RhovFnTdbWPb RhFnTdbRhov RhFnTdbRhovLBnd0C RhFnTdbRhovBnd0C RhFnTdbWPb TwbFnTdbWPb VFnTdbWPb
WFnTdpPb WFnTdbH WFnTdbTwbPb WFnTdbRhPb PsatFnTemp TsatFnHPb TsatFnPb CpCW CpHW RhoH2O FatalHaltEP SevereWarnEP WarnEP
TrendValue TrendAverage TrendMax TrendMin TrendDirection TrendSum CurveValue
"""
FUNCTIONS = (*_OTHERS.split(), *(day + quantity for day in _DAYS for quantity in _WEATHER.split()))
"""Built-in functions of EnergyPlus's runtime language; case does not matter."""


def program_findings(objects: ModelObjects) -> Iterator[RuleFinding]:
    """Yield the errors of all programs and subroutines: of their syntax, and of those that run themselves."""
    programs = [
        (kind, name, fields)
        for kind in (f"{_EMS}Program", f"{_EMS}Subroutine")
        for name, fields in objects.get(kind, {}).items()
    ]
    names = [name for _, name, _ in programs]
    for kind, name, fields in programs:
        for each in _syntax_findings(fields.get("lines", ()), names):
            yield finding(kind, name, each)
    yield from _endless_calls(objects)


def _syntax_findings(lines: Sequence[Mapping[str, Any]], programs: Sequence[str]) -> Iterator[FieldFinding]:
    """Yield the errors in the lines of a program; `programs` are the names that `RUN` may have."""
    ifs, loops = list[tuple[str, bool]](), list[str]()  # paths of what is open; an IF also has whether its ELSE came
    for index, entry in enumerate(lines):
        path = f"lines[{index}].program_line"
        line = str(entry.get("program_line", "")).strip(" ")
        if not line:
            continue
        keyword, _, rest = line.partition(" ")
        keyword, rest = keyword.upper(), rest.strip()
        block_error = _block_error(keyword, path, ifs, loops)
        if text := _statement_error(keyword, rest, programs) or block_error:
            yield FieldFinding(path, f": {path} is {line!r}: {text}")
    for path, _ in ifs[-1:]:
        yield FieldFinding(path, f": {path} begins an IF without an ENDIF")
    for path in loops:
        yield FieldFinding(path, f": {path} begins a WHILE without an ENDWHILE; EnergyPlus would never end it")


def _statement_error(keyword: str, rest: str, programs: Sequence[str]) -> str:
    """Return what is wrong with a statement by itself; empty if nothing is."""
    if keyword.startswith("!"):
        return "a program has no comments"
    if keyword not in _KEYWORDS:
        return f"{keyword!r} is no keyword; {did_you_mean(keyword, _KEYWORDS)}"
    if keyword in _STANDS_ALONE:
        instead = "; write ELSEIF" if keyword == "ELSE" and rest.upper().startswith("IF") else ""
        return f"nothing may follow {keyword} in its line{instead}" if rest else ""
    if keyword == "RUN":
        known = {name.casefold() for name in programs}
        return "" if rest.casefold() in known else f"there is no program {rest!r}; {did_you_mean(rest, programs)}"
    if keyword == "SET":
        variable, equals, rest = rest.partition("=")
        if not equals or not variable.strip():
            return "SET needs a variable, '=' and an expression"
    if not rest.strip() and keyword != "RETURN":
        return f"{keyword} needs an expression"
    return _expression_error(rest)


def _expression_error(expression: str) -> str:
    depth = 0
    for character in expression:
        depth += (character == "(") - (character == ")")
        if depth < 0:
            break
    if depth:
        return "a ')' is missing" if depth > 0 else "a '(' is missing"
    if unexpected := _UNEXPECTED.search(_OPERATORS.sub(" ", expression)):
        hint = "a program has no comments" if unexpected[0] == "!" else "operators are ==, <>, <=, >=, &&, ||"
        return f"{unexpected[0]!r} is not expected; {hint}"
    known = {name.casefold() for name in FUNCTIONS}
    for name in _FUNCTION.findall(expression):
        if name.casefold() not in known:
            return f"there is no function '@{name}'; {did_you_mean(name, FUNCTIONS)}"
    return ""


def _block_error(keyword: str, path: str, ifs: list[tuple[str, bool]], loops: list[str]) -> str:
    """Return what is wrong with a statement after those before it, which `ifs` and `loops` keep; empty if nothing."""
    if keyword in ("ELSE", "ELSEIF", "ENDIF") and not ifs:
        return f"there is no IF before this {keyword}"
    if keyword == "ENDWHILE" and not loops:
        return "there is no WHILE before this ENDWHILE"
    if keyword == "ELSE" and ifs[-1][1]:
        return "its IF has an ELSE already"
    if keyword == "IF":
        ifs.append((path, False))
        return f"more than {_MOST_IFS} nested IF" if len(ifs) > _MOST_IFS else ""
    if keyword == "WHILE":
        loops.append(path)
        return "a WHILE within another one" if len(loops) > 1 else ""
    if keyword == "ELSE":
        ifs[-1] = (ifs[-1][0], True)
    elif keyword == "ENDIF":
        ifs.pop()
    elif keyword == "ENDWHILE":
        loops.pop()
    return ""


def _endless_calls(objects: ModelObjects) -> Iterator[RuleFinding]:
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
