"""The end of processes: by a signal, and by force where they ignore it."""

import signal
import subprocess
import sys

import pytest

from zenostat.bridge.runtime.processes import end_processes

IGNORES = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"


def started(first: str) -> subprocess.Popen[str]:
    program = f"{first}print('ready', flush=True); input()"
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.mark.parametrize("openings", [[""], [IGNORES], [IGNORES, "", IGNORES]])
def test_end_processes__every_process_has_ended_and_is_reaped(openings: list[str]) -> None:
    processes = [started(opening) for opening in openings]
    end_processes(processes, 0.5)
    expected = {"": -signal.SIGTERM, IGNORES: -signal.SIGKILL}
    assert [process.returncode for process in processes] == [expected[opening] for opening in openings]
    end_processes(processes, 0.5)  # once more changes nothing
    for process in processes:
        process.communicate()
