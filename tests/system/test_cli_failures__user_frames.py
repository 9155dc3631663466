"""A controller of the user's that fails: its own frames and one line; signals before and after a command's work."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.nodes import NodeProgram, until
from support.run_cli import ZENOSTAT, run_python

MINE = """
from zenostat.agent_sdk.controllers import Controller


def gain(sample):
    return 1.0 / (sample.step - 3)


class Mine(Controller):
    def act(self, sample):
        return {"core_zn_cooling_setpoint": 26.0 + 0.0 * gain(sample)}
"""


def run(node: NodeProgram, text: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "mine.py").write_text(text)
    command = [*ZENOSTAT, "run", "--node", "office", "--controller", "mine.py:Mine", "--connect", node.endpoint]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=120)


@pytest.mark.slow
def test_cli_failures__exception_shows_the_users_frames_alone(node: NodeProgram, scratch: Path) -> None:
    done = run(node, MINE, scratch)
    assert done.returncode == 1
    files = re.findall(r'File "([^"]+)", line (\d+), in (\w+)', done.stderr)
    assert [(Path(file).name, line, name) for file, line, name in files] == [
        ("mine.py", "11", "act"),
        ("mine.py", "6", "gain"),
    ]
    assert done.stderr.splitlines()[-1] == "error: mine.py, line 6: ZeroDivisionError: float division by zero"


@pytest.mark.slow
def test_cli_failures__error_of_ours_in_the_users_code_states_where(node: NodeProgram, scratch: Path) -> None:
    done = run(node, MINE.replace("gain(sample)}", "sample['core_zn_air']}"), scratch)
    assert done.returncode in (1, 2)
    assert re.findall(r"line (\d+), in (\w+)", done.stderr) == [("11", "act")]
    assert "core_zn_air_temperature" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_cli_failures__signal_during_imports_ends_without_a_traceback(number: signal.Signals, tmp_path: Path) -> None:
    """The import of typer is held up until the signal has come."""
    mark = tmp_path / "imports"
    (tmp_path / "typer.py").write_text(f"import signal\nopen({str(mark)!r}, 'w').close()\nsignal.pause()\n")
    program = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from zenostat.cli.main import main; main()"
    with subprocess.Popen([sys.executable, "-P", "-c", program], stderr=subprocess.PIPE, text=True) as process:
        until(mark.exists, "it imports typer")
        process.send_signal(number)
        _, stderr = process.communicate(timeout=60)
    assert (process.returncode, stderr) == (128 + number, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_cli_failures__signal_during_the_shutdown_ends_without_a_traceback(number: signal.Signals) -> None:
    program = (
        f"import atexit, os, sys; atexit.register(lambda: os.kill(os.getpid(), {int(number)}))\n"
        "sys.argv = ['zenostat', '--version']; from zenostat.cli.main import main; main()"
    )
    done = run_python("-P", "-c", program, env={**os.environ}, timeout=60)
    assert done.returncode == 0, "all was done before it came"
    assert done.stdout.startswith("zenostat ")
    assert done.stderr == ""
