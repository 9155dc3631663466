"""The `rerun` program: viewers and screenshots of recordings."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from topics.errors import InvalidConfig

NO_VULKAN = "a picture needs a Vulkan driver, and none was found; on Debian: apt install mesa-vulkan-drivers libvulkan1"
_DRIVERS = ("/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d")
"""Where the Vulkan loader searches for drivers, besides its environment variables."""

_START_S = 20.0
_SETTLE_S = 1.5  # `open` returns before all plots are drawn, and the viewer does not report when they are


def program() -> str:
    """Return the path of the `rerun` binary; it would outlive the Python script of the same name."""
    spec = importlib.util.find_spec("rerun_cli")
    folders = spec.submodule_search_locations if spec else None
    if not folders:
        raise InvalidConfig("the rerun program is not installed: pip install rerun-sdk")
    return str(Path(folders[0]) / "rerun")


def has_vulkan() -> bool:
    """Return whether a Vulkan loader and a driver are installed, as far as their files show."""
    try:
        ctypes.CDLL("libvulkan.so.1")
    except OSError:
        return False
    named = any(os.environ.get(name) for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"))
    own = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share") / "vulkan/icd.d"
    return named or any(any(folder.glob("*.json")) for folder in (*map(Path, _DRIVERS), own))


def how_to_open(recording: Path) -> str:
    """Return the commands that show a recording, with a display and without one."""
    beside = Path(sys.executable).parent / "rerun"
    name = "rerun" if shutil.which("rerun") or not beside.exists() else shlex.quote(str(beside))
    return f"{name} {shlex.quote(str(recording))} (in a browser: {name} --web-viewer {shlex.quote(str(recording))})"


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def _serving(port: int, *options: str) -> Iterator[None]:
    """Run the program on loopback within this context; `InvalidConfig` if it ends before it listens."""
    command = [program(), "--bind", "127.0.0.1", "--port", str(port), *options]
    # A viewer does not remove its temporary folder when it is terminated.
    with tempfile.TemporaryDirectory(prefix="zenostat-") as folder:
        server = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "TMPDIR": folder},
            start_new_session=True,
        )
        try:
            _wait_for_port(server, port)
            yield
        finally:
            server.terminate()
            server.wait()


@contextmanager
def web_viewer() -> Iterator[tuple[str, str]]:
    """Serve the viewer as a web page on loopback; yield the page's address and the recording's address."""
    grpc, web = _free_port(), _free_port()
    with _serving(grpc, "--serve-web", "--web-viewer-port", str(web)):
        url = f"rerun+http://127.0.0.1:{grpc}/proxy"
        yield f"http://127.0.0.1:{web}/?url={url}", url


def _wait_for_port(server: subprocess.Popen[bytes], port: int) -> None:
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        if server.poll() is not None:
            raise InvalidConfig(f"the rerun program ended with code {server.returncode} before it listened")
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise InvalidConfig(f"the rerun program did not listen on port {port} within {_START_S:.0f} s")


def screenshot(recording: Path, picture: Path) -> bool:
    """Render a recording as a PNG of 1920 x 1080 without a display; return False without a Vulkan driver."""
    from rerun.experimental import ViewerClient

    port = _free_port()
    try:
        with _serving(port, "--headless", "--window-size", "1920x1080"):
            viewer = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            viewer.open(str(recording.absolute()))
            time.sleep(_SETTLE_S)
            viewer.save_screenshot(str(picture.absolute()))
    except (InvalidConfig, ConnectionError):  # without a driver it ends at its start, sometimes after it listens
        return False
    return picture.exists()
