"""Check what the linters cannot: names that say nothing, imports against the layers, import cycles."""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VAGUE = frozenset({"said", "told", "given", "found", "made", "here", "there", "who", "_told", "_said"})
# A package imports only from these, and from itself; in functions and for types as well.
LAYERS = {
    "topics": set(),
    "models": {"topics"},
    "bridge": {"topics"},
    "eplus_node": {"topics", "models", "bridge"},
    "agent_sdk": {"topics", "bridge"},
    "metrics": {"topics", "bridge", "agent_sdk"},
    "views": {"topics", "bridge", "agent_sdk", "metrics"},
    "lab": {"topics", "bridge", "agent_sdk", "metrics", "views"},
    "gateways": {"topics", "bridge", "agent_sdk", "metrics"},
    "cli": {"topics", "models", "bridge", "eplus_node", "agent_sdk", "metrics", "views", "lab", "gateways"},
}
# These use the public names: `zenostat.connect`.
PUBLIC = {"cli"}
# Only these packages import the simulator itself.
SIMULATORS = {"pyenergyplus": {"models", "eplus_node"}}


def vague_names(path: Path, text: str) -> list[str]:
    """Identifiers that name nothing."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [
        f"{path}:{token.start[0]}: {token.string!r} says nothing; name the thing"
        for token in tokens
        if token.type == tokenize.NAME and token.string in VAGUE
    ]


def imported(tree: ast.Module) -> list[tuple[int, str]]:
    """Lines and names of the modules of this project and of simulators that a module imports, wherever it does."""
    modules = []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        modules += [(node.lineno, name) for name in names if name.split(".")[0] in {"zenostat", *SIMULATORS}]
    return modules


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
    faults, graph = [], {}
    paths = [path for package in LAYERS for path in sorted((root / package).rglob("*.py"))]
    modules = {
        ".".join(("zenostat", *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__"): path
        for path in paths
    }
    for module, path in modules.items():
        text = path.read_text(encoding="utf-8")
        faults += vague_names(path.relative_to(root), text)
        package, needs = layer(module), set()
        for line, name in imported(ast.parse(text)):
            if not may_import(package, layer(name)):
                faults.append(f"{path.relative_to(root)}:{line}: {package} must not import {name}")
            if name in modules and name != module:
                needs.add(name)
        # A package's __init__ gathers what is below it; that is no cycle.
        graph[module] = {name for name in needs if not module.startswith(f"{name}.")}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        faults.append(f"import cycle: {' -> '.join(error.args[1])}")
    print("\n".join(dict.fromkeys(faults)) or "names and imports: all checks passed")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
