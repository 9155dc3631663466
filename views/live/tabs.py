"""The tabs of the layout, by name."""

from __future__ import annotations

from typing import Any

from zenostat.topics.errors import InvalidConfig, ViewerError, did_you_mean

OVERVIEW_TAB = "Overview"
NODE_TABS = ("Building", "Zones", "Energy", "Grid", "Control", "Other points", "Events")
PLANT_TAB = "Plant"
"""First tab of a node without zones, in place of `Building`."""

Blueprint = dict[str, dict[str, dict[str, Any]]]
"""A viewer's blueprint: archetypes by entity, and their fields."""


def check_tab(name: str) -> None:
    """Raise `InvalidConfig` if no layout has a tab of this name; only a layout tells the names of its nodes."""
    node, _, tab = name.rpartition("/")
    known = (*NODE_TABS, PLANT_TAB, *(() if node else (OVERVIEW_TAB,)))
    if tab not in known:
        raise InvalidConfig(f"--tab {name}: there is no tab {tab!r}; {did_you_mean(tab, known)}")


def open_tab(blueprint: Blueprint, name: str) -> None:
    """Open a tab in a blueprint.

    Args:
        blueprint: of the viewer; changed in place.
        name: such as `Control` or, of one of several nodes, `office/Control`.

    Raises:
        ViewerError: the layout has no such tab, or the tabs of several nodes have this name.
    """
    root = blueprint["/viewport"]["ViewportBlueprint"]["root_container"]
    tabs = _paths(blueprint, str(root), ())
    matches = [path for path, _ in tabs if name in (path[-1][0], "/".join(part for part, _ in path))]
    if len(matches) != 1:
        names = ["/".join(part for part, _ in path) for path, is_leaf in tabs if is_leaf]
        problem = "several nodes have the tab" if matches else "the layout has no tab"
        raise ViewerError(f"--tab {name}: {problem} {name!r}; {did_you_mean(name, names)}")
    container = _fields(blueprint, str(root))
    for _, child in matches[0]:
        container["active_tab"] = child
        container = _fields(blueprint, child)


_Path = tuple[tuple[str, str], ...]
"""Names and entities of tabs, from the outermost."""


def _paths(blueprint: Blueprint, root: str, above: _Path) -> list[tuple[_Path, bool]]:
    """Return the tabs of nodes and those in them, and whether each has none within it."""
    paths: list[tuple[_Path, bool]] = []
    contents = _fields(blueprint, root).get("contents", [])
    for child in [contents] if isinstance(contents, str) else contents:
        fields = _fields(blueprint, child)
        path = (*above, (str(fields.get("display_name", "")).partition(": ")[0], child))
        is_node = fields.get("container_kind") == "Tabs" and path[-1][0] not in NODE_TABS
        paths.append((path, not is_node))
        if is_node:
            paths += _paths(blueprint, child, path)
    return paths


def _fields(blueprint: Blueprint, entity: str) -> dict[str, Any]:
    """Return a container's fields, by its entity or its bare id."""
    path = entity if entity.startswith(("container/", "view/")) else f"container/{entity}"
    archetypes = blueprint.get(f"/{path}", {})
    return archetypes.get("ContainerBlueprint", {})
