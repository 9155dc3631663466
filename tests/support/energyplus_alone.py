"""EnergyPlus alone: a model that the wheel's own API runs in a process of its own."""

import subprocess
import sys
from pathlib import Path

_RUN = """
import json, sys
from pyenergyplus.api import EnergyPlusAPI
model, weather, folder, *arguments = sys.argv[1:]
api = EnergyPlusAPI()
state, exchange, runtime = api.state_manager.new_state(), api.exchange, api.runtime
runtime.set_console_output_status(state, False)
{before}
code = runtime.run_energyplus(state, ["-w", weather, "-d", folder, model])
{after}
sys.exit(code)
"""


def energyplus_command(
    model: Path, weather: Path, folder: Path, *arguments: str, before: str = "", after: str = ""
) -> list[str]:
    """Return a command that runs a model and ends with EnergyPlus's exit code.

    Args:
        arguments: Texts for these statements, which have them as `arguments`.
        before: Python statements, which have EnergyPlus's `state`, `exchange` and `runtime`.
        after: Statements after the run, which have its exit code as `code` besides.
    """
    program = _RUN.replace("{before}", before).replace("{after}", after)
    return [sys.executable, "-P", "-c", program, str(model), str(weather), str(folder), *arguments]


def run_energyplus(
    model: Path, weather: Path, folder: Path, *arguments: str, before: str = "", after: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run a model to the end; see `energyplus_command`."""
    command = energyplus_command(model, weather, folder, *arguments, before=before, after=after)
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
