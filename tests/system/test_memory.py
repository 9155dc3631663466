"""Memory of a node: within its limit, and no more after many episodes than after a few."""

import psutil
import pytest
from support.nodes import WEATHER, NodeProgram, engines_of, node_on_bus

LIMIT_BYTES = 450e6
GROWTH_BYTES = 5e6


def _memory(node: NodeProgram) -> tuple[int, int]:
    """Resident bytes: of the node and the engine of its episode; and of all engines, shared pages counted twice."""
    own, engines = psutil.Process(node.pid).memory_info().rss, engines_of(node.pid)
    return int(own + engines[-1].memory_info().rss), sum(int(engine.memory_info().rss) for engine in engines)


@pytest.mark.slow
def test_memory__medium_office_is_small_and_does_not_grow(scratch):
    day = {"building": "office-medium", "weather": WEATHER, "begin": "07-03", "end": "07-03", "steps_per_hour": 4}
    with node_on_bus(scratch / "node", **day) as (node, bus):
        link = bus.controller("office")
        held, descriptors = [], []
        for _ in range(50):
            sample = link.reset()
            for _ in range(10):
                sample.send()
                sample = link.receive()
            held.append(_memory(node))
            descriptors.append(psutil.Process(node.pid).num_fds())
    assert max(used for used, _ in held) < LIMIT_BYTES
    for total in zip(*held, strict=True):
        assert total[-1] <= max(total[:5]) + GROWTH_BYTES
    assert descriptors[-1] <= max(descriptors[:5])
