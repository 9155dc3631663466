"""The samples that precede the monitor: many points and long replies are read in parts."""

import numpy as np
import pytest
from support import builders

from zenostat.topics import codec
from zenostat.topics.messages import HistoryQuery, HistorySeries
from zenostat.views.live.history import read_history


class _Node:
    """A node with 1,500 points whose value is `1000 * point + step`; it replies with at most `rows` samples."""

    def __init__(self, rows: int, *, loses: int = 0) -> None:
        self.manifest = builders.manifest(sensors=[builders.sensor(f"s{n}", "", unit="m") for n in range(1499)])
        self.rows, self.loses, self.oldest, self.episode = rows, loses, 0, 3
        self.queries: list[HistoryQuery] = []

    def query(self, query: HistoryQuery) -> HistorySeries | None:
        names = [*self.manifest.names, *(actuator.name for actuator in self.manifest.actuators)]
        self.queries.append(query)
        first = max(query.from_step or 0, self.oldest)
        self.oldest += self.loses  # it runs on
        if first > query.to_step:
            return None
        steps = np.arange(first, min(first + self.rows, query.to_step + 1))
        columns = np.array([names.index(name) for name in query.points])
        table = (1000.0 * columns[None, :] + steps[:, None]).astype(codec.FLOAT)
        return HistorySeries(
            episode=self.episode, points=query.points, units=[""] * len(columns), first_step=first, stride=1,
            remaining=query.to_step - int(steps[-1]), oldest_step=self.oldest, latest_step=99, values=table.tobytes(),
        )  # fmt: skip


@pytest.mark.parametrize(("rows", "loses"), [(100, 0), (7, 0), (7, 2)])
def test_rerun_history__all_points_of_all_samples_that_the_node_has(rows: int, loses: int) -> None:
    node = _Node(rows, loses=loses)
    first, table = read_history(node.query, node.manifest, 3, 20)
    points = len(node.manifest.points) + len(node.manifest.actuators)
    assert (first > 0) == (loses > 0)
    assert all(len(query.points) <= 1000 for query in node.queries)
    expected = 1000.0 * np.arange(points)[None, :] + np.arange(first, 21)[:, None]
    np.testing.assert_array_equal(table, expected)


def test_rerun_history__another_episode_has_no_samples_of_this_one() -> None:
    node = _Node(100)
    assert read_history(node.query, node.manifest, 2, 20) is None


def test_rerun_history__node_that_has_replaced_all_of_them() -> None:
    node = _Node(100)
    node.oldest = 50
    assert read_history(node.query, node.manifest, 3, 20) is None
