"""The graph of a district: strongly connected components, their order, and cycles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

N = TypeVar("N")

Graph = Mapping[N, Sequence[N]]
"""The successors of each node."""


def graph_of(nodes: Iterable[N], edges: Iterable[tuple[N, N]]) -> dict[N, list[N]]:
    """Return the successors of each node, without repetitions, in the order of the edges."""
    graph: dict[N, list[N]] = {node: [] for node in nodes}
    for source, target in edges:
        if target not in graph[source]:
            graph[source].append(target)
    return graph


def components(graph: Graph[N]) -> list[list[N]]:
    """Return the strongly connected components in topological order, each in the order of the nodes of the graph.

    The algorithm of Tarjan (SIAM J. Comput. 1, 146-160, 1972), without recursion. Its order is that of the graph's
    nodes and edges only, so equal graphs have equal results.
    """
    index: dict[N, int] = {}
    low: dict[N, int] = {}
    stack: list[N] = []
    on_stack: set[N] = set()
    results: list[list[N]] = []
    position = {node: number for number, node in enumerate(graph)}
    for root in reversed([*graph]):  # components come out in reverse, so that independent nodes keep their order
        if root in index:
            continue
        work: list[tuple[N, Iterator[N]]] = [(root, iter(graph[root]))]
        index[root] = low[root] = len(index)
        stack.append(root)
        on_stack.add(root)
        while work:
            node, successors = work[-1]
            for successor in successors:
                if successor not in index:
                    index[successor] = low[successor] = len(index)
                    stack.append(successor)
                    on_stack.add(successor)
                    work.append((successor, iter(graph[successor])))
                    break
                if successor in on_stack:
                    low[node] = min(low[node], index[successor])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    cut = stack.index(node)
                    results.append(sorted(stack[cut:], key=position.__getitem__))
                    on_stack.difference_update(stack[cut:])
                    del stack[cut:]
    return results[::-1]


def feedback_edges(nodes: Iterable[N], edges: Sequence[tuple[N, N]]) -> list[int]:
    """Return the indices of edges without which a graph has no cycle: those that lead back in a depth-first search."""
    outgoing: dict[N, list[int]] = {node: [] for node in nodes}
    for number, (source, _) in enumerate(edges):
        outgoing[source].append(number)
    back: list[int] = []
    active: dict[N, bool] = {}
    for root in outgoing:
        if root in active:
            continue
        active[root] = True
        work = [(root, iter(outgoing[root]))]
        while work:
            node, rest = work[-1]
            number = next(rest, -1)
            if number < 0:
                active[node] = False
                work.pop()
            elif active.get(edges[number][1]):
                back.append(number)
            elif edges[number][1] not in active:
                active[edges[number][1]] = True
                work.append((edges[number][1], iter(outgoing[edges[number][1]])))
    return sorted(back)


def is_loop(component: Sequence[N], graph: Graph[N]) -> bool:
    """Return whether a component has a cycle: several nodes, or one that is its own successor."""
    return len(component) > 1 or component[0] in graph[component[0]]


def find_cycle(graph: Graph[N]) -> list[N]:
    """Return the nodes of a shortest cycle, in order; empty if the graph has none."""
    best: list[N] = []
    for component in components(graph):
        if not is_loop(component, graph):
            continue
        for start in component:
            cycle = _shortest_cycle(graph, start)
            if cycle and (not best or len(cycle) < len(best)):
                best = cycle
    return best


def _shortest_cycle(graph: Graph[N], start: N) -> list[N]:
    previous: dict[N, N] = {}
    border = [start]
    while border:
        following: list[N] = []
        for node in border:
            for successor in graph[node]:
                if successor == start:
                    return _path(previous, start, node)
                if successor not in previous:
                    previous[successor] = node
                    following.append(successor)
        border = following
    return []


def _path(previous: Mapping[N, N], start: N, end: N) -> list[N]:
    path = [end]
    while path[-1] != start:
        path.append(previous[path[-1]])
    return path[::-1]


def levels(order: Sequence[Sequence[N]], graph: Graph[N]) -> list[list[Sequence[N]]]:
    """Return components in groups that can run side by side: each depends on components of earlier groups only.

    Args:
        order: the components in topological order, as `components` returns them.
        graph: the graph.
    """
    depth: dict[N, int] = {node: 0 for component in order for node in component}
    groups: list[list[Sequence[N]]] = []
    for component in order:
        own = max(depth[node] for node in component)
        for node in component:
            depth[node] = own
            for successor in graph[node]:
                if successor not in component:
                    depth[successor] = max(depth[successor], own + 1)
        while len(groups) <= own:
            groups.append([])
        groups[own].append(component)
    return groups
