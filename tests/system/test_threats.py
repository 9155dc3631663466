"""The threat page: each of its sentences names a test, and what no other file tests is tested below."""

import json
import os
import pickle
import re
import shutil
import socket
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
from support.certificates import expire
from support.gateways import RunningGateway
from support.links import CuttableLink
from support.nodes import NodeProgram, free_port, until
from support.run_cli import run_program, run_python
from support.tank_plant import TANK
from zenoh.handlers import RingChannel

import zenostat
from zenostat import Bus
from zenostat.bridge.node.settings import NodeSettings
from zenostat.bridge.transport.certificates import add, make
from zenostat.bridge.transport.identity import names_of
from zenostat.bridge.transport.name_list import NAMES
from zenostat.bridge.transport.session import open_session
from zenostat.cosim.node_plant import FoundPlant
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig, NodeLost, NodeNotFound, RequestRejected
from zenostat.topics.keys import Role
from zenostat.topics.messages import Event

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "threats.md"
PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
POINT = "zone_1_cooling_setpoint"
NOBODY = 65534
"""Number of a user of Linux who owns no files."""

STRANGER = """
import json, os, sys
import msgpack, zenoh

user, endpoint, point = int(sys.argv[1]), sys.argv[2], sys.argv[3]
config = zenoh.Config()
for name, value in {
    "mode": "client", "connect/endpoints": [endpoint], "connect/timeout_ms": 2000, "scouting/multicast/enabled": False
}.items():
    config.insert_json5(name, json.dumps(value))
if user != os.geteuid():
    os.setgroups([])
    os.setgid(user)
    os.setuid(user)
with zenoh.open(config) as session:
    for key, fields in ((f"rpc/write/ppo-7/{point}", {"value": 27.0, "priority": 1}), ("rpc/stop/the_owner", {})):
        (reply,) = session.get(f"zenostat/v3/office/{key}", payload=msgpack.packb(fields), timeout=60)
        print(reply.ok.encoding)
"""
"""A program of a user, by number, that writes and stops a node under names that it chooses."""

READER = """
import os, sys

os.setgroups([])
os.setgid(int(sys.argv[1]))
os.setuid(int(sys.argv[1]))
open(sys.argv[2])
"""


# The page


def sentences() -> list[tuple[str, list[str]]]:
    """Return each row of the page's tables: its sentence, and the tests that its last cell names."""
    rows = [line.strip("| ").split(" | ") for line in PAGE.read_text("utf-8").splitlines() if line.startswith("|")]
    return [
        (" ".join(cells[:-1]), re.findall(r"`(\w+)`", cells[-1]))
        for cells in rows
        if not re.match("-|who|what", cells[0])
    ]


def test_threats__each_sentence_of_the_page_has_a_test_that_exists() -> None:
    source = "\n".join(path.read_text("utf-8") for path in sorted((ROOT / "tests").rglob("test_*.py")))
    defined = set(re.findall(r"^(?:async )?def (test_\w+)", source, flags=re.MULTILINE))
    assert len(sentences()) > 40
    for sentence, tests in sentences():
        assert sentence.endswith("."), sentence
        assert tests, f"no test shows: {sentence}"
        assert set(tests) <= defined, f"{sentence}: there is no {', '.join(set(tests) - defined)}"


def test_threats__page_has_no_statement_outside_of_its_tables() -> None:
    _, *sections = re.split(r"^## .+$", PAGE.read_text("utf-8"), flags=re.MULTILINE)
    lines = [line for section in sections for line in section.splitlines() if line]
    assert [line for line in lines if not line.startswith("|")] == []


# Without keys


def node_without_keys(folder: Path) -> NodeProgram:
    """Start a node that listens as it does by default, on another port."""
    return NodeProgram(folder / "open", plant=PLANT, listen=[f"tcp/{keys.DEFAULT_HOST}:{free_port()}"])


@pytest.fixture(scope="module")
def open_node(module_folder: Path) -> Iterator[NodeProgram]:
    with node_without_keys(module_folder) as running:
        yield running


@pytest.mark.slow
def test_threats__node_listens_on_loopback_alone_unless_exposed(open_node: NodeProgram) -> None:
    assert NodeSettings().listen == [f"tcp/{keys.DEFAULT_HOST}:{keys.DEFAULT_PORT}"]
    processes = [psutil.Process(open_node.pid), *psutil.Process(open_node.pid).children(recursive=True)]
    sockets = [connection for process in processes for connection in process.net_connections()]
    assert {connection.laddr.ip for connection in sockets} == {"127.0.0.1"}


needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")


@pytest.mark.slow
def test_threats__without_keys_any_user_of_the_machine_writes_and_stops_under_any_name(folder: Path) -> None:
    user = NOBODY if os.geteuid() == 0 else os.geteuid()
    with node_without_keys(folder) as own, zenostat.connect(own.endpoint, affinity="off") as bus:
        bus.manifest("office")
        with bus.session.declare_subscriber(keys.EVENT.at("office"), RingChannel(100)) as events:
            bus.status("office")
            done = run_python("-c", STRANGER, str(user), own.endpoint, POINT)
            written = until(events.try_recv, "the value is written")
        assert done.stdout.splitlines() == ["application/msgpack;zenostat/3.Ack"] * 2, done.stderr
        assert codec.decode(Event, written.payload.to_bytes()).source == "ppo-7"
        assert own.process.wait() == 0


@needs_root
@pytest.mark.slow
def test_threats__node_on_a_unix_socket_in_a_private_folder_is_out_of_reach_of_other_users(folder: Path) -> None:
    with NodeProgram(folder / "socket", plant=PLANT) as node:
        (folder / "socket").chmod(0o700)
        done = run_python("-c", STRANGER, str(NOBODY), node.endpoint, POINT)
        assert done.returncode != 0
        assert "Unable to connect" in done.stderr
        assert node.process.poll() is None
        assert run_python("-c", STRANGER, str(os.geteuid()), node.endpoint, POINT).returncode == 0, "the owner does"


# With keys


@pytest.fixture(scope="module")
def node(module_folder: Path, pki: Path) -> Iterator[NodeProgram]:
    listen = [f"tls/127.0.0.1:{free_port()}"]
    with NodeProgram(module_folder / "node", plant=PLANT, listen=listen, keys=str(pki)) as running:
        yield running


@needs_root
def test_threats__other_users_cannot_read_keys(pki: Path) -> None:
    pki.parent.chmod(0o755)  # as a home that others may enter
    assert "PermissionError" in run_python("-c", READER, str(NOBODY), f"{pki}/controller.key").stderr
    assert run_python("-c", READER, "0", f"{pki}/controller.key").returncode == 0


@pytest.mark.slow
def test_threats__eavesdropper_reads_a_link_without_keys_and_nothing_of_one_with_keys(
    node: NodeProgram, pki: Path, open_node: NodeProgram
) -> None:
    for endpoint, folder, is_readable in ((node.endpoint, pki, False), (open_node.endpoint, None, True)):
        kind, _, port = endpoint.partition("/")[0], *endpoint.rpartition(":")[1:]
        with CuttableLink(int(port)) as link:
            through = link.endpoint.replace("tcp/", f"{kind}/")
            certificate = None if folder is None else "monitor"
            with zenostat.connect(through, keys=folder, certificate=certificate, affinity="off") as bus:
                assert bus.manifest("office").node == "office"
        for words in (b"zenostat/v3/office", POINT.encode()):
            assert (words in link.forwarded) is is_readable


@pytest.mark.slow
def test_threats__certificate_that_expires_soon_is_warned_of_and_renewed_while_the_node_runs(folder: Path) -> None:
    make(folder / "keys", days=20)
    listen = [f"tls/127.0.0.1:{free_port()}"]
    arguments = {"keys": folder / "keys", "certificate": "controller", "affinity": "off"}
    with NodeProgram(folder / "node", plant=PLANT, listen=listen, keys=str(folder / "keys")) as node:
        with pytest.warns(UserWarning, match=r"expires on .* in 19 days; renew it with: zenostat keys add NAME "):
            zenostat.connect(node.endpoint, **arguments).close()
        options = ("--connect", node.endpoint, "--keys", str(folder / "keys"))
        text = r"\S*monitor.pem expires on .* in 19 days; renew it with: zenostat keys add NAME --role ROLE --force"
        assert re.fullmatch(f"warning: {text}\n", run_program("status", *options).stderr)
        (line,) = run_program("--log", "json", "status", *options).stderr.splitlines()
        entry = json.loads(line)
        assert entry["level"] == "warning"
        assert re.fullmatch(text, entry["message"])
        with RunningGateway("modbus", "office", *options, "--address", "127.0.0.1:0") as gateway:
            assert len(re.findall("warning: .*gateway.pem expires on", gateway.end()[2])) == 1
        plant = FoundPlant("office", node.endpoint, folder / "keys")
        plant.recover()
        assert plant.reset(0).values.shape[0] == 1
        plant.close()
        assert len([text for text in plant.manifest.warnings if "trainer.pem expires on" in text]) == 1
        assert plant.drain_warnings() == []
        add(folder / "keys", Role.CONTROLLER, "controller", force=True)
        with warnings.catch_warnings(action="error"), zenostat.connect(node.endpoint, **arguments) as renewed:
            assert renewed.nodes() == ["office"]
            assert renewed.controller("office", name="agent").name.startswith("controller.agent")


@pytest.mark.slow
def test_threats__link_ends_when_its_certificate_expires(
    node: NodeProgram, pki: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own"
    shutil.copytree(pki, own)
    expire(own, "monitor", monkeypatch, Role.MONITOR, days=20 / 86400)
    with pytest.warns(UserWarning, match="expires on"):
        bus = zenostat.connect(node.endpoint, keys=own, role=Role.MONITOR, affinity="off")
    with bus, bus.listen("office") as samples:
        assert len(bus.session.info.links()) == 1
        with pytest.raises(NodeLost, match=r"'office' is gone.*monitor\.pem expired on .*; renew it with"):
            list(samples)
        assert bus.session.info.links() == []
        with pytest.raises(NodeNotFound, match=r"there are none.*monitor\.pem expired on"):
            bus.manifest("office")


@pytest.mark.slow
def test_threats__node_whose_certificate_expires_is_lost_with_that_reason(
    scratch: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pki = tmp_path / "keys"
    make(pki)
    expire(pki, "brief", monkeypatch, Role.NODE, days=30 / 86400)
    settings = {"plant": TANK, "name": "tank", "keys": str(pki / "brief.pem")}
    with (
        NodeProgram(scratch / "node", listen=[f"tls/127.0.0.1:{free_port()}"], **settings) as brief,
        zenostat.connect(brief.endpoint, keys=pki, role=Role.MONITOR, affinity="off") as bus,
        bus.listen("tank") as samples,
        pytest.raises(NodeLost, match=f"the certificate at {brief.endpoint} has expired"),
    ):
        list(samples)


@pytest.mark.slow
def test_threats__copy_of_a_certificate_and_its_key_is_that_name(node: NodeProgram, pki: Path, tmp_path: Path) -> None:
    for name in ("ca.pem", "operator.pem", "operator.key"):
        shutil.copy(pki / name, tmp_path)
    with zenostat.connect(node.endpoint, keys=tmp_path / "operator.pem", affinity="off") as thief:
        thief.pace("office", mode="lockstep")
        assert thief.identity == "operator"


@pytest.mark.slow
def test_threats__authority_s_key_makes_certificates_of_any_role(node: NodeProgram, pki: Path, tmp_path: Path) -> None:
    """It makes a node's, whose holder is trusted with all messages although no list of names has it yet."""
    stolen = tmp_path / "stolen"
    stolen.mkdir(mode=0o700)
    for name in ("ca.pem", "ca.key", NAMES):
        shutil.copy(pki / name, stolen)
    add(stolen, Role.NODE, "forged")
    endpoint = f"tls/127.0.0.1:{free_port()}"
    with (
        open_session(listen=[endpoint], keys=stolen, certificate="forged", role=Role.NODE),
        open_session(connect=[endpoint], keys=pki, role=Role.MONITOR) as deceived,
    ):
        assert len(list(deceived.info.routers_zid()) + list(deceived.info.peers_zid())) == 1


def test_threats__earlier_list_of_names_is_followed(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    make(folder)
    add(folder, Role.OPERATOR, "panel")
    earlier = (folder / NAMES).read_bytes()
    add(folder, Role.MONITOR, "panel", force=True)
    assert names_of(folder)["panel"] == (Role.MONITOR,)
    (folder / NAMES).write_bytes(earlier)
    assert names_of(folder)["panel"] == (Role.OPERATOR,)


def test_threats__controller_claims_at_any_priority(node: NodeProgram, pki: Path, bus: Bus) -> None:
    with zenostat.connect(node.endpoint, keys=pki, certificate="second", affinity="off") as other:
        first = bus.controller("office", priority=10, required=False)
        first.reset()
        bus.write("office", POINT, 26.0, priority=8, source="screen")
        with other.controller("office", priority=1) as second:
            second.current()
            second.send({POINT: 24.0})
            until(lambda: bus.latest("office").step == [1], "the step is simulated")
            assert other.read("office").value_source[POINT] == second.name
        with pytest.raises(RequestRejected, match="is claimed by"):
            other.controller("office", priority=10)
        first.close()


def test_threats__operator_has_a_node_record_into_any_folder(
    node: NodeProgram, pki: Path, bus: Bus, tmp_path: Path
) -> None:
    with zenostat.connect(node.endpoint, keys=pki, role=Role.OPERATOR, affinity="off") as operator:
        operator.record("office", tmp_path / "here.mcap", now=True)
        operator.stop_recording("office")
        with pytest.raises(InvalidConfig, match="mcap"):
            operator.record("office", tmp_path / "here.txt", now=True)
    assert [path.name for path in tmp_path.iterdir()] == ["here.mcap"]


@pytest.mark.slow
def test_threats__failed_connections_keep_new_programs_out_for_a_while_and_disturb_no_others(
    node: NodeProgram, pki: Path, bus: Bus
) -> None:
    """Zenoh waits for a tenth of a second after each connection without a handshake."""
    host, port = "127.0.0.1", int(node.endpoint.rpartition(":")[2])
    with bus.controller("office") as link:
        sample = link.reset()
        for _ in range(300):
            socket.create_connection((host, port)).close()
        with pytest.raises(NodeNotFound):
            open_session(connect=[node.endpoint], keys=pki, role=Role.MONITOR)
        while not sample.truncated:
            sample.send({POINT: 25.0})
            sample = link.receive()

    def connects() -> bool:
        try:
            with open_session(connect=[node.endpoint], keys=pki, role=Role.MONITOR):
                return True
        except NodeNotFound:
            return False

    until(connects, "new programs can connect again")


def test_threats__connection_without_a_handshake_is_ended(node: NodeProgram) -> None:
    """Whatever a stranger sends in place of a handshake ends the connection."""
    host, port = "127.0.0.1", int(node.endpoint.rpartition(":")[2])
    for start in (b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\xff\xff" + bytes(1000), os.urandom(1000)):
        with socket.create_connection((host, port), 60) as stranger:
            stranger.sendall(start)
            stranger.shutdown(socket.SHUT_WR)
            while stranger.recv(1000):
                pass
    assert node.process.poll() is None


# Files


class Creates:
    """An object whose pickle creates a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


@pytest.mark.slow
def test_threats__pickle_beside_a_policy_is_a_program(tmp_path: Path) -> None:
    normalization = pytest.importorskip(
        "zenostat.agent_sdk.vec_normalization", reason="stable-baselines3 is not installed", exc_type=ImportError
    )
    policy = tmp_path / "model.zip"
    normalization.normalization_path(policy).write_bytes(pickle.dumps(Creates(tmp_path / "executed")))
    with pytest.raises(InvalidConfig):
        normalization.load_normalization(SimpleNamespace(), policy)
    assert (tmp_path / "executed").exists()
