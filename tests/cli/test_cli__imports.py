"""Imports of `--help`: counted, since a time depends on the machine."""

import pytest
import typer
from support.run_cli import run_python

from zenostat.cli.commands import GROUPS, app, command_name

SCRIPT = """
import sys
from zenostat.cli.main import main
try:
    main()
finally:
    print(*sys.modules, sep="\\n", file=sys.stderr)
"""
SLOW = {
    "asyncio", "gymnasium", "matplotlib", "rerun", "stable_baselines3", "torch", "zenostat.agent_sdk",
    "zenostat.eplus_node", "zenostat.models",
}  # fmt: skip
"""What no help needs: frameworks, and packages of ours that import them."""

NAMES = [command_name(place) for places in GROUPS.values() for place in places]


def imported(*arguments: str) -> set[str]:
    """Return the modules that a command imports as a program."""
    done = run_python("-P", "-c", SCRIPT, *arguments)
    assert (done.returncode, "Usage: " in done.stdout) == (0, True), done.stderr
    return set(done.stderr.splitlines())


def test_cli__list_of_commands_imports_no_command_and_nothing_large() -> None:
    modules = imported("--help")
    assert not modules & (SLOW | {"msgpack", "numpy", "pydantic", "yaml", "zenoh"})
    assert {name for name in modules if name.startswith("zenostat.cli.")} == {
        "zenostat.cli.commands",
        "zenostat.cli.console",
        "zenostat.cli.failures",
        "zenostat.cli.main",
    }


@pytest.mark.parametrize(
    ("command", "others"), [("status", {"zenostat.cli.record", "zenostat.cli.write"}), ("asyncapi", set())]
)
def test_cli__help_of_a_command_imports_its_own_module(command: str, others: set[str]) -> None:
    modules = imported(command, "--help")
    assert not modules & SLOW
    own = {f"zenostat.cli.{place.split('.')[0]}" for places in GROUPS.values() for place in places}
    assert {name for name in modules if name in own} <= {f"zenostat.cli.{command}"} | others


def test_cli__list_has_the_first_paragraph_of_each_command() -> None:
    group = typer.main.get_command(app)
    context = typer.Context(group)
    assert group.list_commands(context) == NAMES
    for name in NAMES:
        command = group.get_command(context, name)
        group._is_listing = True
        listed = group.get_command(context, name)
        group._is_listing = False
        assert listed.help == command.help.split("\n\n")[0]
        assert listed.rich_help_panel == command.rich_help_panel
