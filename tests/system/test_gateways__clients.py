"""Names and permissions of the clients of each gateway, with real clients of its protocol on a real node."""

import json
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
from pymodbus.client import ModbusTcpClient
from support.bacnet import ADVANCE, client, served
from support.boptest import serving
from support.gateways import RunningGateway
from support.mqtt_broker import Broker, needs_broker, needs_mosquitto, payloads
from support.nodes import NodeProgram, until
from support.run_cli import run_in_process
from support.zeromq import GatewayProgram, Peer

from zenostat import Bus
from zenostat.gateways.clients import Clients, read_clients
from zenostat.gateways.zeromq.frames import SENT
from zenostat.topics import keys

COOLING, HEATING = "core_zn_cooling_setpoint", "core_zn_heating_setpoint"
TOKEN, OTHER_TOKEN = "0123456789abcdef", "fedcba9876543210"
FILE = f"""\
clients:
  panel:
    mqtt: wall-panel
    modbus: {{unit: 5, address: 127.0.0.1}}
    bacnet: {{instance: 77}}
    boptest: {TOKEN}
    allow: ["*_cooling_setpoint"]
  other:
    boptest: {OTHER_TOKEN}
"""


@pytest.fixture
def clients_file(tmp_path: Path) -> Path:
    path = tmp_path / "clients.yaml"
    path.write_text(FILE)
    path.chmod(0o600)
    return path


@pytest.fixture
def clients(clients_file: Path) -> Clients:
    return read_clients(clients_file, [], is_exposed=False)


@contextmanager
def gateway(kind: str, endpoint: str, *options: str) -> Iterator[RunningGateway]:
    with RunningGateway(kind, "office", "--connect", endpoint, *options) as running:
        yield running
        code, _, _ = running.end()
        assert code == 0


def _registers(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


@pytest.mark.slow
def test_modbus__client_writes_under_its_name_what_it_may_and_others_nothing(
    stepping_bus: Bus, clients_file: Path
) -> None:
    names = [a.name for a in stepping_bus.manifest("office").actuators]
    cooling, heating = 2 * names.index(COOLING), 2 * names.index(HEATING)
    options = ("--address", "127.0.0.1:0", "--clients", str(clients_file))
    with RunningGateway("modbus", "office", "--connect", stepping_bus.endpoint, *options) as running:
        assert "panel may write" in running.description
        with ModbusTcpClient("127.0.0.1", port=running.port, timeout=20) as device:
            assert not device.write_registers(cooling, _registers(26.5), device_id=5).isError()
            assert device.write_registers(heating, _registers(19.0), device_id=5).exception_code == 1
            assert device.write_registers(cooling, _registers(27.0), device_id=6).exception_code == 1
            assert device.write_coil(cooling // 2, False, device_id=6).exception_code == 1
            arrays = stepping_bus.priorities("office")
            assert arrays[COOLING][7] == (26.5, "modbus.panel")
            assert arrays[HEATING][7] == (None, None)
            read = device.read_holding_registers(cooling, count=2, device_id=6).registers
            assert read == _registers(26.5)  # everybody reads
            stepping_bus.step("office")
            until(lambda: stepping_bus.latest("office").step[0] == 1, "the timestep is simulated")
            assert stepping_bus.read("office").value_source[COOLING] == "modbus.panel"
            until(lambda: device.read_discrete_inputs(16 + cooling // 2, device_id=6).bits[0], "it is in effect")
            assert not device.write_coil(cooling // 2, False, device_id=5).isError()
        code, out, err = running.end()
    assert code == 0
    assert "3 of them for writes that were denied" in out
    assert err.splitlines() == [
        f"a write of 127.0.0.1, unit 5, was denied: panel may not write {HEATING}; it may write *_cooling_setpoint",
        "a write of 127.0.0.1, unit 6, was denied: a client that neither --clients nor --allow names may not write "
        f"{COOLING}; it may write nothing",
    ]


@pytest.mark.slow
async def test_bacnet__device_is_known_by_its_instance_and_writes_under_its_name(
    stepping_bus: Bus, clients: Clients
) -> None:
    async with served(stepping_bus.endpoint, clients=clients) as (running, unknown, port), client(port, 77) as panel:
        panel.objects = unknown.objects
        assert await unknown.write(COOLING, 27.0, priority=8) == "property write-access-denied"
        assert await unknown.write(COOLING, 1.0, "cov-increment") == "property write-access-denied"
        assert await panel.write(COOLING, 26.5, priority=8) == "ok"
        assert await panel.write(HEATING, 19.0, priority=8) == "property write-access-denied"
        assert await panel.write(ADVANCE, 1.0) == "property write-access-denied"
        assert await panel.write(COOLING, 99.0, priority=8) == "property value-out-of-range"  # it may, but not this
        assert await unknown.read(COOLING) == 26.5
        arrays = stepping_bus.priorities("office")
        assert arrays[COOLING][7] == (26.5, "bacnet.panel")
        assert arrays[HEATING][7] == (None, None)
        assert (running.counts.writes, running.counts.denied) == (1, 4)


async def test_bacnet__exposed_gateway_is_read_only(stepping_bus: Bus) -> None:
    clients = read_clients(None, [], is_exposed=True)
    async with served(stepping_bus.endpoint, clients=clients) as (running, reader, _):
        assert "read-only" in running.description
        assert await reader.read(COOLING) == await reader.read(COOLING, "relinquish-default")
        assert await reader.write(COOLING, 26.5) == "property write-access-denied"
        assert await reader.write(ADVANCE, 1.0) == "property write-access-denied"
    assert stepping_bus.latest("office").step[0] == 0


@pytest.mark.slow
@needs_broker
@needs_mosquitto
def test_mqtt__broker_binds_a_topic_to_its_user_who_writes_under_that_name(
    stepping_bus: Bus, clients_file: Path, tmp_path: Path
) -> None:
    access = ["user gateway", "topic readwrite zenostat/#", "pattern read zenostat/office/#"]
    access += ["pattern write zenostat/office/client/%u/actuator/+/set"]
    (tmp_path / "access").write_text("\n".join(access) + "\n")
    users = tmp_path / "passwords"
    for user in ("gateway", "wall-panel", "intruder"):
        create = [] if users.exists() else ["-c"]
        subprocess.run(["mosquitto_passwd", "-b", *create, str(users), user, user], check=True)
    settings = [f"acl_file {tmp_path / 'access'}", f"password_file {users}", "user root"]
    (tmp_path / "password").write_text("gateway")
    with Broker(tmp_path, settings=settings) as broker:
        options = ["--broker", f"127.0.0.1:{broker.port}", "--clients", str(clients_file), "--username", "gateway"]
        options += ["--password-file", str(tmp_path / "password")]
        root = "zenostat/office"
        own, foreign = f"{root}/client/wall-panel/actuator", f"{root}/client/intruder/actuator"
        with (
            gateway("mqtt", stepping_bus.endpoint, *options),
            broker.client("wall-panel", "wall-panel") as panel,
            broker.client("intruder", "intruder") as intruder,
            broker.client("gateway", "gateway") as trusted,
        ):
            messages: list[tuple[str, str]] = []
            panel.on_message = lambda *received: messages.append((received[-1].topic, received[-1].payload.decode()))
            panel.subscribe(f"{root}/#", 1)
            until(lambda: (f"{root}/status", "online") in messages, "the gateway is ready")

            def result(topic: str) -> dict[str, Any]:
                until(lambda: payloads(messages, topic), "the command has a result")
                return json.loads(payloads(messages, topic)[-1])

            # The broker drops what is not the user's own topic; with QoS 1, some versions end the connection as well.
            for topic in (f"{own}/{COOLING}/set", f"{root}/actuator/{COOLING}/set"):
                intruder.publish(topic, "28")
            intruder.publish(f"{foreign}/{COOLING}/set", "27", 1)
            assert result(f"{foreign}/{COOLING}/result")["error"] == "AccessDenied"
            assert not payloads(messages, f"{own}/{COOLING}/result")
            panel.publish(f"{own}/{HEATING}/set", "19", 1)
            assert result(f"{own}/{HEATING}/result")["error"] == "AccessDenied"
            panel.publish(f"{own}/{COOLING}/set", json.dumps({"value": 26.5, "source": "screen"}), 1)
            assert result(f"{own}/{COOLING}/result")["accepted"]
            arrays = stepping_bus.priorities("office")
            assert arrays[COOLING][7] == (26.5, "mqtt.panel.screen")
            assert arrays[HEATING][7] == (None, None)
            trusted.publish(f"{root}/actuator/{COOLING}/set", "28", 1)  # a topic without a user
            assert "neither --clients nor --allow" in result(f"{root}/actuator/{COOLING}/result")["message"]


@needs_broker
@pytest.mark.slow
def test_mqtt__users_are_their_own_names_without_a_file(stepping_bus: Bus, tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, gateway("mqtt", stepping_bus.endpoint, "--broker", f"127.0.0.1:{broker.port}"):
        until(lambda: broker.retained("zenostat/office/status") == "online", "it is online")
        with broker.subscribed("zenostat/office/client/#") as messages:
            topic = f"zenostat/office/client/Panel.1/actuator/{COOLING}"
            broker.publish(f"{topic}/set", "26.5")
            until(lambda: payloads(messages, f"{topic}/result"), "the command has a result")
            assert stepping_bus.priorities("office")[COOLING][7] == (26.5, f"mqtt.panel_1_{crc32(b'Panel.1'):08x}")
            empty = f"zenostat/office/client//actuator/{COOLING}"
            broker.publish(f"{empty}/set", "24")
            until(lambda: payloads(messages, f"{empty}/result"), "the command has a result")
            assert json.loads(payloads(messages, f"{empty}/result")[0])["message"].startswith(
                "the topic has an empty user"
            )


@pytest.mark.slow
def test_boptest__client_has_tests_of_its_own_and_overrides_what_it_may(clients: Clients) -> None:
    with serving(clients=clients) as running:
        assert running.request("GET", "/testcases").status_code == 200
        refused = running.request("POST", "/testcases/office-small/select")
        assert (refused.status_code, refused.json()["message"]) == (403, "Forbidden")
        running.session.headers["Authorization"] = "Bearer 0000000000000000"
        unknown = running.request("POST", "/testcases/office-small/select")
        assert (unknown.status_code, unknown.headers["WWW-Authenticate"]) == (401, "Bearer")
        running.session.headers["Authorization"] = f"Bearer {TOKEN}"
        running.select("office-small")
        running.put("step", step=900)
        inputs = {f"{COOLING}_u": 299.15, f"{COOLING}_activate": 1, f"{HEATING}_u": 290.15}
        denied = running.answer("POST", "advance", inputs | {f"{HEATING}_activate": 1})
        assert denied.status_code == 403
        assert f"panel may not write {HEATING}" in denied.json()["payload"]
        assert running.advance(**inputs, **{f"{HEATING}_activate": 0})["time"] == 900  # nothing was simulated before
        assert running.service is not None
        simulation = running.service.manager.get(running.testid).simulation
        source = simulation.sample.value_source[COOLING]
        assert source == simulation.owner
        assert source.startswith("boptest.panel")
        running.session.headers["Authorization"] = f"Bearer {OTHER_TOKEN}"
        assert running.get("kpi")  # whoever has the id reads
        for method, operation in (("POST", "advance"), ("PUT", "stop"), ("POST", "branch"), ("PUT", "initialize")):
            body = {"start_time": 0, "warmup_period": 0} if operation == "initialize" else {}
            assert running.answer(method, operation, body).status_code == 403, operation
        del running.session.headers["Authorization"]
        assert running.put("results", point_names=[f"{COOLING}_u"], start_time=0, final_time=900)["time"] == [0, 900]
        assert running.answer("POST", "advance", {}).status_code == 403


def test_zeromq__sender_writes_and_claims_what_it_may(shared_node: NodeProgram, episode_bus: Bus) -> None:
    options = ("--allow", "panel=*_cooling_setpoint", "--allow", "chief=*")
    with GatewayProgram(shared_node.endpoint, *options) as running, Peer(running) as peer:
        assert "panel, chief may write" in running.first_line
        assert peer.ask(f"actuator/panel/{COOLING}", value=26.5)[0] == "Ack"
        for sender, name in (("panel", HEATING), ("panels", COOLING), ("mallory", COOLING)):
            kind, fields = peer.ask(f"actuator/{sender}/{name}", value=20.0)
            assert (kind, fields["error"]) == ("ErrorReply", "AccessDenied")
        assert peer.ask("rpc/claim/panel", controller="panel")[1]["error"] == "AccessDenied"
        assert peer.ask("rpc/claim/panel", controller="panel", actuators=[COOLING])[0] == "Ack"
        assert peer.ask("rpc/claim/panel", controller="panel", actuators=[])[1]["error"] == "AccessDenied"
        assert peer.ask("rpc/pause/panel", source="panel")[1]["error"] == "AccessDenied"
        assert peer.ask("rpc/status")[0] == "Status"
        assert peer.ask("rpc/pause/chief", source="chief")[0] == "Ack"
        assert peer.ask("rpc/resume/chief", source="chief")[0] == "Ack"
        assert episode_bus.priorities("office")[COOLING][7] == (26.5, "panel")


@pytest.mark.slow
def test_zeromq__gateway_refuses_each_request_that_could_change_the_node_and_is_not_allowed(
    shared_node: NodeProgram, episode_bus: Bus
) -> None:
    needed = {
        "alarm": "a", "alternatives": 1, "controller": "mallory", "duration_s": 60.0, "episode": [0], "name": "n",
        "path": "p", "snapshot": "s1", "step": [0], "steps": 1, "timesteps": 1, "value": 20.0, "values": b"",
    }  # fmt: skip
    with GatewayProgram(shared_node.endpoint, "--allow", "panel=?") as running, Peer(running) as peer:
        for key, row in SENT.items():
            bodies = [{name: needed[name] for name, field in row.message.model_fields.items() if field.is_required()}]
            if row is keys.CLAIM:
                bodies = [
                    {"controller": sender, **({} if actuators is None else {"actuators": actuators})}
                    for sender in ("mallory", "panel")
                    for actuators in (None, [], [COOLING], ["*"])
                ]
            for body in bodies:
                topic = key.format(sender=body.get("controller", "mallory"), name=COOLING)
                kind, denied = peer.ask(topic, **body)
                assert (kind, denied["error"]) == ("ErrorReply", "AccessDenied"), (topic, body, denied)
        assert all(peer.ask(key)[0] != "ErrorReply" for key in ("manifest", "sample", "rpc/status", "rpc/priorities"))
    assert episode_bus.status("office").controllers == []


@pytest.mark.parametrize(
    "options",
    [
        ("modbus", "office", "--allow", "panel=x"),
        ("bacnet", "office", "--allow", "panel=x"),
        ("boptest", "--allow", "panel=x"),
        ("mqtt", "office", "--allow", "panel"),
        ("zeromq", "--allow", "panel"),
        ("modbus", "office", "--clients", "nothing.yaml"),
    ],
)
def test_gateways__bad_clients_are_one_error_before_anything_starts(options: tuple[str, ...]) -> None:
    done = run_in_process("gateway", *options)
    assert done.returncode != 0
    assert len(done.stderr.splitlines()) == 1
    assert "--allow panel" in done.stderr or "there is no file" in done.stderr
