"""The `rerun` program: windows, web pages and headless viewers, each with the settings of this process only."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from zenostat.bridge.runtime.processes import end_processes
from zenostat.bridge.runtime.scratch import scratch_folder
from zenostat.topics.errors import InvalidConfig, ViewerError

NO_VULKAN = (
    "a screenshot needs a Vulkan driver, and none was found; on Debian: apt install mesa-vulkan-drivers libvulkan1"
)
NO_DISPLAY = "a window needs a display, and neither DISPLAY nor WAYLAND_DISPLAY is set"
_DRIVERS = ("/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d")
"""Folders in which the Vulkan loader searches for drivers, besides its environment variables."""
_NO_ADAPTER = ("render context", "graphics adapter", "wgpu")
"""Words of the message with which a viewer without a Vulkan driver ends."""

_START_S = 60.0
_EXIT_S = 5.0
_ENDS_WITH_PARENT = (
    "import os, sys; from zenostat.bridge.engine.system_calls import die_with_parent as bind; "
    "bind(int(sys.argv[1])); os.execv(sys.argv[2], sys.argv[2:])"
)
"""Python code that becomes a program, which the kernel ends with the thread that started it."""


def program() -> str:
    """Return the path of the `rerun` binary; it would outlive the Python script of the same name.

    Raises:
        ViewerError: it is not installed.
    """
    spec = importlib.util.find_spec("rerun_cli")
    folders = spec.submodule_search_locations if spec else None
    path = Path(folders[0]) / "rerun" if folders else None
    if path is None or not path.is_file():
        raise ViewerError("the rerun program is not installed: pip install rerun-sdk")
    return str(path)


def has_vulkan() -> bool:
    """Return whether a Vulkan loader and a driver are installed, as far as their files show."""
    try:
        ctypes.CDLL("libvulkan.so.1")
    except OSError:
        return False
    named = any(os.environ.get(name) for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"))
    own = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share") / "vulkan/icd.d"
    return named or any(any(folder.glob("*.json")) for folder in (*map(Path, _DRIVERS), own))


def has_display() -> bool:
    """Return whether the environment names a display for windows."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def how_to_open(recording: Path) -> str:
    """Return the command that shows a recording again."""
    return f"zenostat view {shlex.quote(str(recording))}" + ("" if has_display() else " --web")


@dataclass(frozen=True)
class Server:
    """A running `rerun` program.

    Attributes:
        process: the program.
        url: address of its recordings.
        log: the file of what it prints.
    """

    process: subprocess.Popen[bytes]
    url: str
    log: Path

    def check(self) -> None:
        """Raise `ViewerError` with the reason if the program has ended."""
        if (code := self.process.poll()) is not None:
            raise ViewerError(_reason_of_end(code, self.log.read_text(errors="replace")))


def _reason_of_end(code: int, printed: str) -> str:
    if any(words in printed for words in _NO_ADAPTER):
        return NO_VULKAN
    if code < 0:
        return f"the rerun program was killed by {signal.Signals(-code).name}"
    reason = next((line.strip() for line in printed.splitlines() if line.strip()), "it printed no reason")
    return f"the rerun program ended with code {code}: {reason}"


@contextmanager
def serving(*options: str, environment: Mapping[str, str] | None = None) -> Iterator[Server]:
    """Run the program on loopback within this context; it ends with this process, however that ends.

    Its temporary files and its settings are in a folder of its own, and it sends no usage data.

    Args:
        options: its options, and files to open.
        environment: environment variables for it, besides those of this process.

    Raises:
        ViewerError: the program is missing, or it ends before it listens.
    """
    port = free_port()
    command = [program(), "--bind", "127.0.0.1", "--port", str(port), *options]
    with scratch_folder() as folder:  # it removes no files when it is terminated
        log = folder / "viewer.log"
        own = {**dict.fromkeys(("TMPDIR", "XDG_CONFIG_HOME", "XDG_RUNTIME_DIR"), str(folder)), "CI": "1"}
        with log.open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", _ENDS_WITH_PARENT, str(os.getpid()), *command],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={**os.environ, **own, **(environment or {})},
                start_new_session=True,
            )
        server = Server(process, f"rerun+http://127.0.0.1:{port}/proxy", log)
        try:
            _wait_for_port(server, port)
            yield server
        finally:
            end_processes([process], _EXIT_S)


@contextmanager
def web_viewer(*recordings: Path) -> Iterator[tuple[str, str]]:
    """Serve the viewer as a web page on loopback; yield the page's address and the address for live data."""
    web = free_port()
    files = [str(recording.absolute()) for recording in recordings]
    with serving("--serve-web", "--web-viewer-port", str(web), *files) as server:
        yield f"http://127.0.0.1:{web}/?url={server.url}&hide_welcome_screen=true", server.url


def window(recording: Path) -> None:
    """Show a recording in a window until it is closed.

    Raises:
        InvalidConfig: there is no display.
        ViewerError: the program is missing or fails.
    """
    if not has_display():
        raise InvalidConfig(f"{NO_DISPLAY}; without one, use --web or --screenshot FILE.png")
    with readable(recording) as path:
        done = subprocess.run([program(), str(path.absolute())], stderr=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise ViewerError(_reason_of_end(done.returncode, done.stderr))


@contextmanager
def readable(recording: Path) -> Iterator[Path]:
    """Yield a recording's path, or that of a temporary copy of what can be read of it.

    Viewers reject a recording that lacks its end: its monitor was killed or is still writing.

    Raises:
        ViewerError: the file is not a recording.
    """
    if _is_complete(recording):
        yield recording
        return
    with scratch_folder() as folder:
        copy = folder / recording.name
        command = [program(), "rrd", "merge", "--continue-on-error", str(recording.absolute()), "-o", str(copy)]
        subprocess.run(command, capture_output=True, check=False)
        if not _is_complete(copy):
            raise ViewerError(f"{recording} is not a recording that zenostat monitor wrote")
        yield copy


def _is_complete(recording: Path) -> bool:
    """Return whether a viewer can open a recording."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings(action="ignore"):
        try:
            return bool(RrdReader(str(recording)).recordings())
        except (RuntimeError, OSError, ValueError):
            return False


def free_port() -> int:
    """Return a port of loopback on which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_for_port(server: Server, port: int) -> None:
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        server.check()
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise ViewerError(f"the rerun program did not listen on port {port} within {_START_S:.0f} s")
