"""Check names, openings of docstrings, imports against the layers, and import cycles, as no linter does."""

from __future__ import annotations

import ast
import gc
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VAGUE = re.compile(r"_*(said|says|told|given|found|made|here|there|who|came|went|stood|heard|ruled)_*", re.IGNORECASE)
OPENING = re.compile(r"(What|Who|Whose|Where|When|How|Has|Is|Does|As|Of|The same)\b")
# These have names and docstrings as well, and import what they like.
BESIDE = ("tests", "bench", "examples", ".ci")
# A package imports only from these, and from itself; in functions and for types as well.
LAYERS = {
    "topics": set(),
    "models": {"topics"},
    "bridge": {"topics"},
    "eplus_node": {"topics", "models", "bridge"},
    "plants": {"topics", "bridge"},
    "cosim": {"topics", "bridge"},
    "agent_sdk": {"topics", "bridge"},
    "metrics": {"topics", "bridge", "agent_sdk"},
    "views": {"topics", "bridge", "agent_sdk", "metrics"},
    "lab": {"topics", "bridge", "agent_sdk", "metrics", "views"},
    "gateways": {"topics", "bridge", "metrics"},
    "cli": {
        *("topics", "models", "bridge", "eplus_node", "plants", "cosim"),
        *("agent_sdk", "metrics", "views", "lab", "gateways"),
    },
}
# These use the public names: `zenostat.connect`.
PUBLIC = {"cli"}
# Only these packages import the simulator itself.
SIMULATORS = {"pyenergyplus": {"models", "eplus_node"}}


@cache  # each check walks over all modules
def nodes(tree: ast.Module) -> tuple[ast.AST, ...]:
    """A module's nodes, breadth first."""
    return tuple(ast.walk(tree))


def names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Lines and names of what a module defines: variables, attributes, parameters, functions, classes."""
    for node in nodes(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()) | ast.arg(arg=name):
                yield node.lineno, name
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield node.lineno, name
            case ast.ExceptHandler(name=str(name)) | ast.alias(asname=str(name)):
                yield node.lineno, name


def style_errors(tree: ast.Module) -> list[tuple[int, str]]:
    """Lines and texts of names that say nothing, and of docstrings that do not open with a verb or a noun phrase."""
    vague = [(line, name) for line, name in names(tree) if VAGUE.fullmatch(name)]
    errors = [(line, f"{name!r} says nothing; name the thing") for line, name in vague]
    for node in nodes(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if opening := OPENING.match(ast.get_docstring(node) or ""):
            text = f"docstring opens with {opening[0]!r}; open with an imperative verb or a noun phrase"
            errors.append((node.body[0].lineno, text))
    return errors


def test_name_errors(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Lines and texts of tests that are not named `test_<unit>__<behavior>`."""
    for node in nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            unit, _, behavior = node.name.partition("__")
            if unit == "test_" or not behavior:
                yield node.lineno, f"{node.name!r} is not test_<unit>__<behavior>"


def imported(tree: ast.Module) -> list[tuple[int, str]]:
    """Lines and names of what a module imports of this project and of simulators, wherever it does.

    A name that is imported from a module is named with it: `zenostat.topics.errors.InvalidConfig`.
    """
    modules = []
    for node in nodes(tree):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        modules += [(node.lineno, name) for name in names if name.split(".")[0] in {"zenostat", *SIMULATORS}]
    return modules


def loaded(tree: ast.Module) -> Iterator[str]:
    """Names of the modules of this project that a module imports by a text: plug-ins, and what an extra brings."""
    for node in nodes(tree):
        match node:
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[ast.Constant(value=str(text)), *_]):
                if name in {"import_module", "import_extra", "__import__"} and text.startswith("zenostat."):
                    yield text


def definitions(path: Path, tree: ast.Module) -> set[str]:
    """Names that can be imported from a module: its own, those it imports, and the modules of its folder."""
    members = {name for _, name in names(tree)}
    imports = [node for node in nodes(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    members |= {alias.asname or alias.name for node in imports for alias in node.names}
    if path.name == "__init__.py":
        members |= {other.stem for other in path.parent.iterdir()}
    return members


def unresolved(tree: ast.Module, defined: dict[str, set[str]]) -> Iterator[tuple[int, str]]:
    """Lines and texts of imports from this project of a module, or of a name, that does not exist."""
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            missing = [alias.name for alias in node.names if alias.name not in defined]
        elif isinstance(node, ast.ImportFrom) and node.module in defined:
            members = defined[node.module]
            missing = [f"{node.module}.{alias.name}" for alias in node.names if not {alias.name, "*"} & members]
        elif isinstance(node, ast.ImportFrom):
            missing = [str(node.module)]
        else:
            continue
        yield from ((node.lineno, f"there is no {name}") for name in missing if name.startswith("zenostat"))


def shared_file_names(paths: Iterable[Path], root: Path) -> Iterator[str]:
    """Yield a fault for each test file whose name another one has: pytest collects one of them alone."""
    first: dict[str, Path] = {}
    for path in paths:
        if path.name.startswith("test_") and first.setdefault(path.name, path) != path:
            yield f"{path.relative_to(root)}:1: {first[path.name].relative_to(root)} has the same name"


def layer(module: str) -> str:
    """Package of a module, or name of a simulator; the public names of `zenostat` belong to no package."""
    return module.removeprefix("zenostat.").partition(".")[0]


def may_import(package: str, other: str) -> bool:
    """Whether a package may import another one, or a simulator; only programs at the top use the public names."""
    if other in SIMULATORS:
        return package in SIMULATORS[other]
    return other == package or other in LAYERS[package] or (other not in LAYERS and package in PUBLIC)


def main(root: Path = ROOT) -> int:
    """Print each fault; the exit code says whether there is any."""
    gc.disable()  # it would search the trees of all modules again and again
    faults, graph = [], {}
    paths = [path for package in LAYERS for path in sorted((root / package).rglob("*.py"))]
    modules = {
        ".".join(("zenostat", *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__"): path
        for path in paths
    }
    beside = [path for folder in BESIDE for path in sorted((root / folder).rglob("*.py"))]
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in [*paths, *beside]}
    public = {f"zenostat.{path.stem}".removesuffix(".__init__"): path for path in (root / "src/zenostat").glob("*.py")}
    trees |= {path: ast.parse(path.read_text(encoding="utf-8")) for path in public.values()}
    defined = {module: definitions(path, trees[path]) for module, path in {**modules, **public}.items()}
    defined.setdefault("zenostat", set()).update(LAYERS)
    for path, tree in trees.items():
        # mypy resolves the packages' own imports.
        errors = [*style_errors(tree), *(unresolved(tree, defined) if path in beside else ())]
        errors += test_name_errors(tree) if path.name.startswith("test_") else ()
        faults += [f"{path.relative_to(root)}:{line}: {text}" for line, text in errors]
    faults += shared_file_names(beside, root)
    for module, path in modules.items():
        package, needs = layer(module), set(loaded(trees[path]))
        for line, name in imported(trees[path]):
            if not may_import(package, layer(name)):
                faults.append(f"{path.relative_to(root)}:{line}: {package} must not import {name}")
            needs.add(name if name in modules else name.rpartition(".")[0])
        graph[module] = needs & modules.keys()
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        faults.append(f"import cycle: {' -> '.join(error.args[1])}")
    print("\n".join(dict.fromkeys(faults)) or "names, docstrings and imports: all checks passed")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
