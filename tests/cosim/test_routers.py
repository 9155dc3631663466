"""A district whose buildings are nodes behind two routers, as they would be on other machines."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.district_files import DISTRICT, STEPS, write_district
from support.nodes import NodeProgram

import zenostat  # noqa: F401  # registers the environments
from zenostat.bridge.transport.session import open_session


def episode(file: Path) -> list[bytes]:
    """The values of all samples of an episode."""
    with gym.make("zenostat/District-v1", file=file) as created:
        env: Any = created.unwrapped
        env.reset(seed=8)
        rows = [env.sample.message.values]
        for step in range(STEPS):
            env.step(np.float32([400.0 * step, 1000.0, -500.0, 2000.0]))
            rows.append(env.sample.message.values)
        return rows


@pytest.mark.slow
def test_district__behind_two_routers_equals_the_one_on_this_machine_to_the_bit(scratch: Path) -> None:
    """Two plants are elsewhere, each behind a router of its own; the rest of the file stays as it is."""
    local = episode(write_district(scratch))
    text, plant = DISTRICT, f"{scratch}/plants.py"
    with ExitStack() as stack:
        for name, arguments in (("east", {}), ("west", {"residents_w": 900.0})):
            endpoint = f"unixsock-stream/{scratch}/{name}-router"
            stack.enter_context(open_session(listen=[endpoint], mode="router"))  # type: ignore[arg-type]
            settings = {"plant": f"{plant}:House", "plant_arguments": arguments, "name": f"far-{name}"}
            stack.enter_context(NodeProgram(scratch / name, listen=[], connect=[endpoint], **settings))
            started = next(line for line in text.splitlines() if line.startswith(f"  {name}:"))
            text = text.replace(started, f"  {name}: {{node: far-{name}, connect: {endpoint}}}")
        assert "plants.py:House" not in text
        (scratch / "far.yaml").write_text(text)
        assert episode(scratch / "far.yaml") == local
