"""A real MQTT broker, and its own command-line clients."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.nodes import free_port, until

MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")

needs_mosquitto = pytest.mark.skipif(
    MOSQUITTO is None or shutil.which("mosquitto_pub") is None,
    reason="mosquitto is not installed; on Debian: apt install mosquitto mosquitto-clients",
)


class Broker:
    """A mosquitto of one test module, on loopback."""

    def __init__(self, folder: Path, *lines: str) -> None:
        self.port = free_port()
        self._file = folder / "mosquitto.conf"
        self._file.write_text(
            "\n".join(
                [f"listener {self.port} 127.0.0.1", "max_queued_messages 0", *(lines or ["allow_anonymous true"])]
            )
        )
        self.options = ["-h", "127.0.0.1", "-p", str(self.port)]
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [MOSQUITTO or "", "-c", str(self._file)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )

    def __enter__(self) -> Broker:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def is_up(self) -> bool:
        command = ["mosquitto_pub", *self.options, "-q", "1", "-t", "up", "-m", "1"]
        return subprocess.run(command, capture_output=True, timeout=30).returncode == 0

    def publish(self, topic: str, payload: str, *options: str) -> None:
        command = ["mosquitto_pub", *self.options, "-q", "1", "-t", topic, "-m", payload, *options]
        done = subprocess.run(command, capture_output=True, text=True, timeout=30)
        assert done.returncode == 0, done.stderr

    def retained(self, topic: str, *options: str) -> str | None:
        """The retained message of a topic; None without one."""
        command = ["mosquitto_sub", *self.options, "-t", topic, "-C", "1", "-W", "3", "--retained-only", *options]
        done = subprocess.run(command, capture_output=True, text=True, timeout=30)
        return done.stdout.rstrip("\n") if done.returncode == 0 else None

    @contextmanager
    def subscribed(self, topic: str, folder: Path) -> Iterator[Path]:
        """All messages of a topic go to a file, as lines `TOPIC PAYLOAD`, once this has been entered."""
        file = folder / f"{topic.replace('/', '_').replace('+', 'x').replace('#', 'all')}.txt"
        command = ["mosquitto_sub", *self.options, "-q", "1", "-t", topic, "-t", f"ready/{file.name}", "-v"]
        with file.open("w") as out, subprocess.Popen(command, stdout=out) as program:
            try:

                def is_subscribed() -> bool:
                    self.publish(f"ready/{file.name}", "yes")
                    return "yes" in file.read_text()

                until(is_subscribed, "the client has subscribed")
                yield file
            finally:
                program.terminate()


def lines(file: Path, topic: str) -> list[str]:
    """Payloads of a topic in a file of `Broker.subscribed`."""
    return [line.partition(" ")[2] for line in file.read_text().splitlines() if line.partition(" ")[0] == topic]
