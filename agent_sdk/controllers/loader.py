"""Controllers by name: the ones that come along, and anybody's class in a file or a module."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

from agent_sdk.controllers.base import BaselineController, Controller, ControllerProtocol
from agent_sdk.controllers.fixed import FixedSetpoints
from agent_sdk.controllers.incremental import IncrementalRules
from agent_sdk.controllers.pid import PIDController
from agent_sdk.controllers.random_control import RandomController
from agent_sdk.controllers.rule_based import RuleBasedController
from agent_sdk.controllers.setback import ScheduledSetback
from topics.errors import InvalidConfig, UnknownName, did_you_mean

CONTROLLERS: dict[str, type[Controller]] = {
    "building": BaselineController,
    "rbc": RuleBasedController,
    "random": RandomController,
    "fixed": FixedSetpoints,
    "setback": ScheduledSetback,
    "incremental": IncrementalRules,
    "pid": PIDController,
}
"""Short names, as `zenostat run --controller` takes them."""

# The first are imported by now, so that no file beside a stranger's stands in for them. The others this side never
# imports (docs/architecture.md), so that a stranger's `models.py` may stand in for one while his file is loaded.
_NEEDED = ("agent_sdk", "bridge", "topics")
_NOT_NEEDED = ("models", "eplus_node", "cli")


def load_controller(text: str) -> Callable[..., ControllerProtocol]:
    """The class of a controller; it is made with the node's manifest and its parameters by name.

    Args:
        text: a short name; `path/to/file.py:MyController`; or `package.module:MyController`, which may lie in the
            present folder. While it is loaded, what lies beside the file can be imported, and goes before installed
            modules of the same name.

    Raises:
        UnknownName: no such name, file, module or class.
        InvalidConfig: the file fails while it is loaded, or the class is no controller.
    """
    if text in CONTROLLERS:
        return CONTROLLERS[text]
    place, colon, name = text.rpartition(":")
    if not colon or not place or not name:
        known = did_you_mean(text, CONTROLLERS, limit=len(CONTROLLERS))
        raise UnknownName(
            f"no controller {text!r}; {known}; a class of your own is path/to/file.py:MyController "
            f"or package.module:MyController"
        )
    return _controller(_module(place), name, place)


def _module(place: str) -> ModuleType:
    path = Path(place).expanduser()
    is_file = path.suffix == ".py" or "/" in place
    if is_file and not path.is_file():
        raise UnknownName(f"there is no file {path.absolute()} to take a controller from")
    folder = path.absolute().parent if is_file else Path.cwd()
    try:
        with _beside(folder):
            return _from_file(path) if is_file else importlib.import_module(place)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and error.name and f"{place}.".startswith(f"{error.name}."):
            raise UnknownName(f"there is no module {place!r}, neither installed nor in {folder}") from None
        raise InvalidConfig(f"{place} fails while it is loaded: {_said(error)}{_hint(folder, path)}") from error


def _from_file(path: Path) -> ModuleType:
    name = f"_controller_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path.absolute())
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # data classes and pickles look their module up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


class _Siblings:
    """Finds modules in a folder, before Python's own finders."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As Python's own finders."""
        return PathFinder.find_spec(name, [self._folder], target) if path is None else None


@contextmanager
def _beside(folder: Path) -> Iterator[None]:
    """What lies in a folder can be imported meanwhile; no module of ours is another one afterwards."""
    finder = _Siblings(folder)
    importlib.invalidate_caches()
    shadowing = [name for name in _NOT_NEEDED if _is_anothers(finder.find_spec(name), name)]
    ours = {name: module for name, module in sys.modules.items() if name.partition(".")[0] in shadowing}
    for name in ours:
        del sys.modules[name]
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in [name for name in sys.modules if name.partition(".")[0] in shadowing]:
            del sys.modules[name]
        sys.modules.update(ours)


def _is_anothers(sibling: ModuleSpec | None, name: str) -> bool:
    if sibling is None:
        return False
    mine = Path(__file__).resolve().parent.parent.parent / name / "__init__.py"
    return sibling.origin is None or Path(sibling.origin).resolve() != mine


def _said(error: BaseException) -> str:
    """The exception and the line of the stranger's that it comes from."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "importlib" not in f.filename]
    own = [f for f in frames if f.filename != __file__]
    where = f" (line {own[-1].lineno} of {Path(own[-1].filename).name})" if own else ""
    return f"{type(error).__name__}: {error}{where}"


def _hint(folder: Path, path: Path) -> str:
    """Says so where the file imports a neighbour that is called like a part of ours."""
    taken = [name for name in _NEEDED if (folder / f"{name}.py").is_file() and name in _imported(path)]
    return f"; {taken[0]}.py has the name of a part of Zenostat: give it another" if taken else ""


def _imported(path: Path) -> set[str]:
    try:
        body = list(ast.walk(ast.parse(path.read_text())))
    except (OSError, SyntaxError, ValueError):
        return set()
    plain = {alias.name for node in body if isinstance(node, ast.Import) for alias in node.names}
    return plain | {node.module for node in body if isinstance(node, ast.ImportFrom) and node.module}


def _controller(module: ModuleType, name: str, place: str) -> Callable[..., ControllerProtocol]:
    found = getattr(module, name, None)
    if found is None:
        there = [n for n, thing in vars(module).items() if _acts(thing)]
        raise UnknownName(f"there is no {name!r} in {place}; {did_you_mean(name, there)}")
    if not _acts(found):
        raise InvalidConfig(f"{name} of {place} is no controller; a class with a method act(sample) expected")
    if inspect.isabstract(found):
        raise InvalidConfig(f"{name} of {place} is no controller: its act(sample) is abstract")
    if all(p.kind is p.KEYWORD_ONLY for p in inspect.signature(found).parameters.values()):
        raise InvalidConfig(
            f"{name} of {place} is no controller: it has to take the node's manifest, as __init__(self, manifest)"
        )
    made: Callable[..., ControllerProtocol] = found
    return made


def _acts(thing: object) -> bool:
    return isinstance(thing, type) and callable(getattr(thing, "act", None))
