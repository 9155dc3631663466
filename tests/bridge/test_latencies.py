"""Latencies: a ring that holds a limited number of them."""

import sys

import pytest

from zenostat.bridge.exchange.latency import LatencyWindow


def test_latencies__one_that_was_hardly_used_is_small() -> None:
    """Each controller that ever came has one: 32 kB each are a hole in the node's heap once it has gone."""
    latencies = LatencyWindow()
    latencies.add(0.001)
    assert sys.getsizeof(latencies._ring) < 512


def test_latencies__latest_4096_and_the_longest_of_all() -> None:
    latencies = LatencyWindow()
    latencies.add(9.0)
    for k in range(2 * 4096):
        latencies.add(1.0 if k < 4096 else 2.0)
    spread = latencies.summary()
    assert (spread.count, spread.median_ms, spread.p99_ms) == (8193, 2000.0, 2000.0)
    assert spread.max_ms == pytest.approx(9000.0)
    assert len(latencies._ring) == 4096
