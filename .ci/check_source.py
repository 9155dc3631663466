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
# A package imports only from these, and from itself.
LAYERS = {
    "topics": set(),
    "models": {"topics"},
    "bridge": {"topics"},
    "eplus_node": {"topics", "models", "bridge"},
    "agent_sdk": {"topics", "bridge"},
    "bridge.gateways": {"topics", "bridge", "agent_sdk"},
    "cli": {"topics", "models", "bridge", "bridge.gateways", "eplus_node", "agent_sdk"},
}
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


def imported(tree: ast.Module) -> list[tuple[int, str, bool]]:
    """Modules of this project and of simulators that a module imports, in functions as well.

    For each: line, name, and whether it is imported when the module is itself imported.
    """
    modules = []
    at_import = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        modules += [
            (node.lineno, name, id(node) in at_import)
            for name in names
            if name.split(".")[0] in {"zenostat", *SIMULATORS}
        ]
    return modules


def layer(module: str) -> str:
    """Layer of a module: its package, or the gateways, which are clients of the bus; public names are `agent_sdk`'s."""
    names = module.removeprefix("zenostat.").split(".")
    candidates = (".".join(names[:2]), names[0])
    return next((name for name in candidates if name in LAYERS or name in SIMULATORS), "agent_sdk")


def may_import(package: str, other: str) -> bool:
    """Whether a layer may import another one, or a simulator."""
    return package in SIMULATORS[other] if other in SIMULATORS else other == package or other in LAYERS[package]


def main(root: Path = ROOT) -> int:
    """Print each fault; the exit code says whether there is any."""
    faults, graph = [], {}
    paths = [path for package in LAYERS if "." not in package for path in sorted((root / package).rglob("*.py"))]
    modules = {
        ".".join(("zenostat", *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__"): path
        for path in paths
    }
    for module, path in modules.items():
        text = path.read_text(encoding="utf-8")
        faults += vague_names(path.relative_to(root), text)
        package, needs = layer(module), set()
        for line, name, at_import in imported(ast.parse(text)):
            if name != "zenostat" and not may_import(package, layer(name)):
                faults.append(f"{path.relative_to(root)}:{line}: {package} must not import {name}")
            if at_import and name in modules and name != module:
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
