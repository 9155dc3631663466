"""Load a Python file of the user's own as it is now, with the modules beside it."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

from typing_extensions import override


class _SourceLoader(SourceFileLoader):
    """Compile a file at each import.

    Python's cached bytecode is that of an earlier text if the file is written again within a second with the same
    length, but a recording has the hash of the text.
    """

    @override
    def get_code(self, fullname: str) -> Any:
        return self.source_to_code(self.get_data(self.path), self.path)


def load_file(name: str, path: Path) -> ModuleType:
    """Load a file as a module of this name, compiled from its present text."""
    loader = _SourceLoader(name, str(path))
    spec = importlib.util.spec_from_file_location(name, path, loader=loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and pickle look up their module
    try:
        loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


@dataclass(frozen=True)
class _FolderFinder:
    """Meta path finder for modules in one folder."""

    folder: str

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a top-level module in the folder; see `importlib.abc.MetaPathFinder`."""
        return PathFinder.find_spec(name, [self.folder], target) if path is None else None


def make_importable(folder: Path) -> None:
    """Let modules in a folder be imported from now on, before installed ones of the same name."""
    if (finder := _FolderFinder(str(folder))) not in sys.meta_path:
        importlib.invalidate_caches()
        sys.meta_path.insert(0, finder)
        sys.path.append(finder.folder)  # which `multiprocessing` passes on to the processes that it spawns


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Make modules in a folder importable within the context."""
    finder = _FolderFinder(str(folder))
    importlib.invalidate_caches()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
