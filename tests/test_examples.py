"""The examples run by themselves."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from nodes import SMALL, NodeProgram

EXAMPLES = Path(__file__).parent.parent / "examples"


def _run(name: str, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_gymnasium_environment(scratch):
    said = _run("gymnasium_environment.py", "--days", "1")
    assert "96 timesteps to 2017-07-02T00:00:00" in said
    assert "{'heating': 20.0, 'cooling': 25.0}" in said


def test_controller_on_the_bus(scratch):
    with NodeProgram(scratch / "node", **SMALL) as node:
        said = _run("controller_on_the_bus.py", "--connect", node.endpoint)
    assert "96 timesteps" in said
    assert "is ruled by saver-" in said
