"""A controller on another host, over a network that loses, reorders and delays packets below Zenoh.

Two network namespaces stand for the hosts. It takes the right to make them, `ip` and `tc`, and a kernel with netem;
where one is missing the test is skipped and says which.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.nodes import SMALL
from support.run_cli import ZENOSTAT

CONTROLLER = """
import hashlib, json, sys, threading
import zenostat
from zenostat.topics.errors import BusError

digest, steps = hashlib.sha256(), 0


def is_there(endpoint):
    try:
        with zenostat.connect(endpoint, affinity="off") as bus:
            return "office" in bus.nodes()
    except BusError:
        return False


while not is_there(sys.argv[1]):
    threading.Event().wait(0.1)
with zenostat.connect(sys.argv[1], affinity="off") as bus, bus.controller("office") as link:
    for sample in link:
        digest.update(sample.values.tobytes())
        steps += 1
        sample.send({"core_zn_cooling_setpoint": 23.0 + sample.step % 5})
print(json.dumps([steps, digest.hexdigest()]))
"""
NETEM = ("delay", "5ms", "3ms", "loss", "5%", "reorder", "25%", "50%")
NODE_ADDRESS, CONTROLLER_ADDRESS = "10.77.0.1", "10.77.0.2"


class Hosts:
    """Two hosts and the cable between them, in network namespaces of this process's descendants."""

    def __init__(self) -> None:
        self._holders: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Hosts:
        for _ in range(2):
            self._holders.append(
                subprocess.Popen(["unshare", "-n", "sh", "-c", "echo; exec sleep 600"], stdout=subprocess.PIPE)
            )
            assert self._holders[-1].stdout is not None
            self._holders[-1].stdout.readline()
        return self

    def __exit__(self, *_: object) -> None:
        for holder in self._holders:
            with holder:  # closes its pipe
                holder.kill()

    def inside(self, host: int, *command: str) -> list[str]:
        """A command as it runs on a host."""
        return ["nsenter", f"--net=/proc/{self._holders[host].pid}/ns/net", *command]

    def do(self, host: int, *command: str) -> None:
        """Runs a command on a host; skips the test where the system refuses it."""
        done = subprocess.run(self.inside(host, *command), capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"{' '.join(command)}: {done.stderr.strip()}")

    def connect(self) -> None:
        """Lays the cable, with an address at each end."""
        peer = str(self._holders[1].pid)
        self.do(0, "ip", "link", "add", "left", "type", "veth", "peer", "name", "right", "netns", peer)
        for host, device, address in ((0, "left", NODE_ADDRESS), (1, "right", CONTROLLER_ADDRESS)):
            self.do(host, "ip", "link", "set", "lo", "up")
            self.do(host, "ip", "address", "add", f"{address}/24", "dev", device)
            self.do(host, "ip", "link", "set", device, "up")


@pytest.fixture
def hosts() -> Iterator[Hosts]:
    for program in ("unshare", "nsenter", "ip", "tc"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed; on Debian: apt install util-linux iproute2")
    if subprocess.run(["unshare", "-n", "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this process may not make network namespaces")
    with Hosts() as hosts:
        hosts.connect()
        yield hosts


def trajectory(hosts: Hosts, folder: Path) -> tuple[int, str]:
    """The samples and their digest, of a day that a controller on the other host rules."""
    folder.mkdir()
    (folder / "run.py").write_text(CONTROLLER)
    endpoint = f"tcp/{NODE_ADDRESS}:7447"
    command = [*ZENOSTAT, "node", "--building", SMALL["building"]]
    command += ["--weather", SMALL["weather"], "--begin", "07-03", "--end", "07-03", "--name", "office"]
    command += ["--listen", endpoint, "--expose"]
    with (folder / "node.log").open("w") as log:
        node = subprocess.Popen(hosts.inside(0, *command), stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        try:
            done = subprocess.run(
                hosts.inside(1, sys.executable, "-P", str(folder / "run.py"), endpoint),
                capture_output=True,
                text=True,
                timeout=120,
                check=False,
            )
        finally:
            node.terminate()
            node.wait(30)
    assert done.returncode == 0, done.stderr + (folder / "node.log").read_text()
    steps, digest = json.loads(done.stdout.splitlines()[-1])
    return steps, digest


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_links__network_that_loses_and_reorders_packets_changes_no_bit(hosts: Hosts, scratch: Path) -> None:
    quiet = trajectory(hosts, scratch / "quiet")
    for host, device in ((0, "left"), (1, "right")):
        hosts.do(host, "tc", "qdisc", "add", "dev", device, "root", "netem", *NETEM)
    assert trajectory(hosts, scratch / "lossy") == quiet
