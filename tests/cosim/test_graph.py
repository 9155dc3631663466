"""Components and cycles of graphs against reachability."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from zenostat.cosim.graph import components, find_cycle, graph_of, is_loop, levels

GRAPHS = st.integers(1, 7).flatmap(
    lambda n: st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=14).map(
        lambda edges: graph_of(range(n), edges)
    )
)


def reachable(graph: dict[int, list[int]], start: int) -> set[int]:
    """Nodes that a path of one edge or more leads to."""
    reached, border = set(), [start]
    while border:
        for node in graph[border.pop()]:
            if node not in reached:
                reached.add(node)
                border.append(node)
    return reached


@given(GRAPHS)
def test_components__two_nodes_are_together_if_each_reaches_the_other(graph: dict[int, list[int]]) -> None:
    order = components(graph)
    number = {node: index for index, component in enumerate(order) for node in component}
    assert sorted(number) == sorted(graph)
    for a in graph:
        for b in graph:
            both = b in reachable(graph, a) and a in reachable(graph, b)
            assert (number[a] == number[b]) == (a == b or both)


@given(GRAPHS)
def test_components__order_is_topological(graph: dict[int, list[int]]) -> None:
    number = {node: index for index, component in enumerate(components(graph)) for node in component}
    assert all(number[a] <= number[b] for a, successors in graph.items() for b in successors)


@given(GRAPHS)
def test_cycle__is_a_cycle_of_the_graph_and_there_is_one_if_a_component_is_a_loop(graph: dict[int, list[int]]) -> None:
    cycle = find_cycle(graph)
    assert bool(cycle) == any(is_loop(component, graph) for component in components(graph))
    assert all(b in graph[a] for a, b in pairwise([*cycle, *cycle[:1]]))
    assert len(set(cycle)) == len(cycle)


@given(GRAPHS)
def test_levels__a_group_depends_on_earlier_groups_only(graph: dict[int, list[int]]) -> None:
    groups = levels(components(graph), graph)
    depth = {node: index for index, group in enumerate(groups) for component in group for node in component}
    together = {node: tuple(component) for group in groups for component in group for node in component}
    for a, successors in graph.items():
        assert all(depth[a] < depth[b] or together[a] == together[b] for b in successors)


def test_components__independent_nodes_keep_their_order() -> None:
    assert components(graph_of("abc", [])) == [["a"], ["b"], ["c"]]
