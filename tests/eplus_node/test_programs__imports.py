"""Slow imports of a node's programs: a start pays for each of them."""

import pytest
from support.run_cli import run_python

THIRD_PARTY = {"cryptography", "gymnasium", "numpy", "psutil", "pydantic", "rich", "typer", "yaml", "zenoh"}


@pytest.mark.parametrize(
    ("program", "needed"),
    [("zenostat.eplus_node", {"numpy", "psutil", "pydantic", "zenoh"}), ("zenostat.eplus_node.engine", set())],
)
def test_programs__program_imports_only_what_each_start_needs(program: str, needed: set[str]) -> None:
    text = f"import sys, {program}.__main__; print(*sys.modules)"
    loaded = run_python("-P", "-c", text, check=True).stdout
    assert {name.partition(".")[0] for name in loaded.split()} & THIRD_PARTY == needed
