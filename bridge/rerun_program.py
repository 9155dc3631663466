"""The `rerun` program: viewers, and a picture of a recording."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from topics.errors import InvalidConfig

NO_VULKAN = "no Vulkan driver was found, so no picture was made; on Debian: apt install mesa-vulkan-drivers libvulkan1"
_START_S = 20.0


def program() -> str:
    """Path of the `rerun` program of this environment."""
    return str(Path(sys.executable).parent / "rerun")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def web_viewer() -> Iterator[tuple[str, str]]:
    """Serves the viewer as a page on loopback: (address of the page, address for the recording)."""
    grpc, web = _free_port(), _free_port()
    command = [program(), "--serve-web", "--bind", "127.0.0.1", "--port", str(grpc), "--web-viewer-port", str(web)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        _wait_for_port(server, grpc)
        url = f"rerun+http://127.0.0.1:{grpc}/proxy"
        yield f"http://127.0.0.1:{web}/?url={url}", url
    finally:
        server.terminate()
        server.wait()


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


def screenshot(recording: Path, picture: Path, *, size: str = "1600x1200") -> bool:
    """Draws a recording into a PNG without a screen; false where there is no Vulkan driver."""
    command = [program(), "--headless", "--screenshot-to", str(picture), "--window-size", size, "--bind", "127.0.0.1"]
    command += ["--port", str(_free_port()), str(recording)]
    try:
        done = subprocess.run(
            command,
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=120,
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0 and picture.exists()
