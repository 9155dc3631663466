"""A program whose terminal is closed, or whose ssh session breaks, ends in order, unless `nohup` has started it."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from support.run_cli import ZENOSTAT
from support.tank_plant import TANK

import zenostat
from zenostat import recording
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.topics.messages import Reset

TIMEOUT_S = 60.0


class Terminal:
    """A terminal with a program in its foreground.

    Args:
        command: of the program.
        ignored: whether the program ignores that its terminal is closed, as `nohup` makes it.
    """

    def __init__(self, *command: str, ignored: bool = False) -> None:
        self._own, other = os.openpty()
        self.text = ""

        def enter() -> None:
            os.login_tty(other)
            signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)

        self.program = subprocess.Popen([*ZENOSTAT, *command], preexec_fn=enter)  # noqa: PLW1509  # for the terminal
        os.close(other)

    def read_until(self, text: str) -> None:
        while text not in self.text:
            self.text += os.read(self._own, 4096).decode(errors="replace")

    def close(self) -> None:
        """Close it, as closing its window does; idempotent."""
        with suppress(OSError):
            os.close(self._own)


@contextmanager
def node_in_terminal(folder: Path, *, ignored: bool = False) -> Iterator[tuple[Terminal, zenostat.Bus]]:
    endpoint = f"unixsock-stream/{folder}/bus"
    words = ("node", "--plant", TANK, "--name", "tank", "--listen", endpoint, "--affinity", "off")
    terminal = Terminal(*words, "--record", f"{folder}/run.mcap", ignored=ignored)
    try:
        terminal.read_until("Press Ctrl-C to stop")
        with zenostat.connect(endpoint, affinity="off") as bus:
            yield terminal, bus
    finally:
        terminal.close()
        terminal.program.kill()
        terminal.program.wait()


def end_of(path: Path) -> tuple[bool, str]:
    with RecordingReader(path) as reader:
        assert list(reader.messages())
        return reader.end.is_complete, reader.end.text


def test_node__that_loses_its_terminal_completes_its_recording(scratch: Path) -> None:
    with node_in_terminal(scratch) as (terminal, bus):
        name = bus.manifest("tank").actuators[0].name
        bus.write("tank", name, 1.0, source="panel")
        terminal.close()
        terminal.program.wait(TIMEOUT_S)
    assert end_of(scratch / "run.mcap") == (True, "")
    assert [(entry.source, entry.kind) for entry in recording.load_log(scratch / "run.mcap")] == [("panel", "write")]


def test_node__that_nohup_has_started_outlives_its_terminal(scratch: Path) -> None:
    with node_in_terminal(scratch, ignored=True) as (terminal, bus):
        terminal.program.send_signal(signal.SIGHUP)
        assert bus.reset("tank", Reset()).episode == [1]
        terminal.program.send_signal(signal.SIGTERM)
        assert terminal.program.wait(TIMEOUT_S) == 0
