"""What a node holds: within its limit, and no more after many episodes than after a few."""

from __future__ import annotations

import psutil
import pytest
from nodes import WEATHER, NodeProgram, engine_of

import agent_sdk

LIMIT_BYTES = 450e6
GROWTH_BYTES = 5e6


def _memory(node: NodeProgram) -> int:
    return int(psutil.Process(node.pid).memory_info().rss + engine_of(node.pid).memory_info().rss)


@pytest.mark.slow
def test_medium_office_is_small_and_does_not_grow(scratch):
    day = {"building": "office-medium", "weather": WEATHER, "begin": "07-03", "end": "07-03", "steps_per_hour": 4}
    with NodeProgram(scratch / "node", **day) as node, agent_sdk.connect(node.endpoint, affinity="off") as bus:
        link = bus.controller("office")
        held, descriptors = [], []
        for _ in range(50):
            sample = link.reset()
            for _ in range(10):
                sample.send()
                sample = link.receive()
            held.append(_memory(node))
            descriptors.append(psutil.Process(node.pid).num_fds())
    assert max(held) < LIMIT_BYTES
    assert held[-1] <= max(held[:5]) + GROWTH_BYTES
    assert descriptors[-1] <= max(descriptors[:5])
