"""A node whose plant computes in the node's own process: `bench.empty_plant`, and a command at which it fails."""

from __future__ import annotations

from collections.abc import Sequence

from bench.empty_plant import EmptyPlant, empty_node
from bridge.node.program import main
from topics.errors import PlantFailed

FATAL = 1313.0


class FragilePlant(EmptyPlant):
    """Fails at one value of its command."""

    def step(self, commands: bytes, active_slots: Sequence[int]) -> list[bool]:
        last = super().step(commands, active_slots)
        if FATAL in self._effective:
            raise PlantFailed(f"the command {FATAL:g} broke the plant")
        return last


if __name__ == "__main__":
    main(lambda settings: empty_node(settings, FragilePlant))
