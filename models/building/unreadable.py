"""List the errors of a model file that could not be read."""

from __future__ import annotations

import re
from pathlib import Path

from zenostat.models import energyplus, schema
from zenostat.models.building.diagnostics import Diagnostic, Severity, diagnose, diagnose_unexpanded
from zenostat.models.building.source_lines import read_source
from zenostat.models.building.template_references import templates_of
from zenostat.models.input_format.source_model import SourceModel
from zenostat.models.upgrade.versions import STEPS, short
from zenostat.topics.errors import ZenostatError

_LINE = re.compile(r"(^|, |: )line (\d+)(?:, column \d+)?: ")


def diagnose_unreadable(path: Path, error: ZenostatError) -> list[Diagnostic]:
    """Return the diagnostics of a file that `read_building` rejected, all errors among them.

    Args:
        path: of the file.
        error: what `read_building` raised; its lines are the errors if they are not about objects of the file.
    """
    diagnostics = _diagnose(read_source(path))
    if not any(each.severity is Severity.ERROR for each in diagnostics):
        head, *rest = str(error).split("\n  ")
        diagnostics = [*(_read_line(text) for text in rest or [head]), *diagnostics]
    return diagnostics


def _diagnose(source: SourceModel) -> list[Diagnostic]:
    if not source.objects:
        return []
    versions = schema.matching_part({"Version": source.objects.get("Version", {})}).get("Version", {})
    version = next((fields.get("version_identifier") for fields in versions.values()), None)
    if version and short(version) != short(energyplus.version()):
        if short(version) not in {step.before for step in STEPS}:
            return []  # the file was read in the engine's input format, so it may have no errors of syntax
        # The engine's schema says nothing on another version's objects.
        return [Diagnostic(Severity.ERROR, kind, name, "", text, line) for line, kind, name, text in source.issues]
    if templates_of(source.objects):
        return diagnose_unexpanded(source.objects, source)
    return diagnose(source.objects, source)


def _read_line(text: str) -> Diagnostic:
    match = _LINE.search(text)
    if match is None:
        return Diagnostic(Severity.ERROR, "", "", "", text)
    before, after = text[: match.start()], text[match.end() :]
    return Diagnostic(Severity.ERROR, "", "", "", f"{before}: {after}" if before else after, int(match[2]))
