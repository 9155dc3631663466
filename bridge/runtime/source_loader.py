"""Load a Python file of the user's own as it is now."""

from __future__ import annotations

import importlib.util
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from typing import Any

from zenostat.topics.typing_compat import override


class _SourceLoader(SourceFileLoader):
    """Compile a file at each import.

    Python's cached bytecode is that of an earlier text if the file is written again within a second with the same
    length, but a recording has the hash of the text.
    """

    @override
    def get_code(self, fullname: str) -> Any:
        return self.source_to_code(self.get_data(self.path), self.path)


def source_spec(name: str, path: Path) -> ModuleSpec:
    """Return the spec of a module from a file, which is compiled from its text; see `importlib.util`."""
    spec = importlib.util.spec_from_file_location(name, path, loader=_SourceLoader(name, str(path)))
    assert spec is not None
    return spec
