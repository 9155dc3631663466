"""The MQTT gateway of a real node on a real broker."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import aiomqtt
import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from support.gateways import RunningGateway
from support.mqtt_broker import BROKER, Broker, Security, needs_broker, needs_mosquitto, payloads
from support.nodes import NodeProgram, until
from support.run_cli import run_in_process

from zenostat import Bus
from zenostat.bridge.transport.session import open_session
from zenostat.gateways.mqtt.broker import Broker as GatewayBroker
from zenostat.gateways.mqtt.gateway import MqttGateway
from zenostat.gateways.node_client import NodeClient
from zenostat.gateways.tasks import cancel
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Reset

pytestmark = needs_broker
PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
COOLING, TEMPERATURE = "core_zn_cooling_setpoint", "core_zn_air_temperature"


@contextmanager
def gateway(endpoint: str, broker: Broker, *options: str) -> Iterator[RunningGateway]:
    """A running gateway of the node `office`; it must end without an error."""
    options = ("--connect", endpoint, "--broker", f"127.0.0.1:{broker.port}", *options)
    with RunningGateway("mqtt", "office", *options) as running:
        yield running
        code, out, err = running.end()
    assert code == 0, err
    assert "samples published" in out
    assert "Traceback" not in err


@pytest.fixture(scope="module")
def broker(module_folder: Path) -> Iterator[Broker]:
    with Broker(module_folder) as started:
        yield started


@pytest.fixture(scope="module")
def served(shared_node: NodeProgram, broker: Broker) -> Iterator[RunningGateway]:
    with gateway(shared_node.endpoint, broker, "--home-assistant") as running:
        yield running


@pytest.fixture
def bus(stepping_bus: Bus) -> Bus:
    return stepping_bus


def result(messages: list[tuple[str, str]], count: int, actuator: str = COOLING) -> dict[str, Any]:
    """The `count`-th result of an actuator's commands, once it is there."""
    topic = f"zenostat/office/actuator/{actuator}/result"
    until(lambda: len(payloads(messages, topic)) >= count, "the command has a result")
    return json.loads(payloads(messages, topic)[count - 1])


@pytest.mark.slow
def test_mqtt_gateway__samples_and_points_are_those_of_the_bus(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    until(lambda: broker.retained("zenostat/office/status") == "online", "it is online")
    with broker.subscribed("zenostat/office/sample") as messages:
        expected = []
        for _ in range(5):
            bus.step("office")
            step = len(expected) + 1
            until(lambda step=step: bus.latest("office").step == [step], "the step is done")
            expected.append(bus.read("office"))
        until(lambda: len(payloads(messages, "zenostat/office/sample")) >= 5, "all samples have come")
    samples = [json.loads(line) for line in payloads(messages, "zenostat/office/sample")][-5:]
    manifest = expected[0].manifest
    scale = {p.name: 1 / manifest.step_s if p.unit == "J" else 1.0 for p in manifest.points}  # energy as mean power
    for sample, view in zip(samples, expected, strict=True):
        assert sample["values"] == {name: value * scale[name] for name, value in view.as_dict().items()}
        assert (sample["episode"], sample["step"], sample["last"]) == (view.episode, view.step, False)
        assert sample["time"] == view.time.isoformat()
        assert sample["effective"] == dict(zip([a.name for a in manifest.actuators], view.effective, strict=True))
    last = expected[-1]
    latest = str(last[TEMPERATURE])
    until(lambda: broker.retained(f"zenostat/office/sensor/{TEMPERATURE}") == latest, "the retained value is the last")
    described = json.loads(broker.retained("zenostat/office/manifest") or "")
    assert [reading["name"] for reading in described["readings"]] == list(manifest.names)


def test_mqtt_gateway__commands_are_answered_and_carried_out(bus: Bus, served: RunningGateway, broker: Broker) -> None:
    topic = f"zenostat/office/actuator/{COOLING}/set"
    with broker.subscribed("zenostat/office/actuator/+/result") as messages:
        broker.publish(topic, "26.5")
        assert result(messages, 1) | {"message": ""} == {
            "accepted": True, "value": 26.5, "message": "", "episode": bus.latest("office").episode[0], "step": 0,
        }  # fmt: skip
        assert bus.priorities("office")[COOLING][7] == (26.5, "mqtt")
        broker.publish(topic, json.dumps({"value": 25.0, "priority": 3, "duration_s": 900, "source": "node-red"}))
        assert result(messages, 2)["accepted"]
        assert bus.priorities("office")[COOLING][2] == (25.0, "mqtt.node-red")
        bus.step("office")
        until(lambda: broker.retained(f"zenostat/office/actuator/{COOLING}") == "25.0", "it is in effect")
        broker.publish(topic, "")
        assert result(messages, 3)["value"] is None
        assert bus.priorities("office")[COOLING][7] == (None, None)
        until(lambda: bus.step("office") or bus.priorities("office")[COOLING][2].value is None, "it expired")


@pytest.mark.parametrize(
    ("payload", "error", "text"),
    [
        ("99", "RequestRejected", "its bounds are"),
        ("warm", "BadMessage", "neither a number nor JSON"),
        ("NaN", "BadMessage", "value"),
        ("Infinity", "BadMessage", "value"),
        ("1e999", "BadMessage", "value"),
        ("true", "BadMessage", "value"),
        ('"26"', "BadMessage", "value"),
        ("[26]", "BadMessage", "value"),
        ("{}", "BadMessage", "value"),
        ('{"value": 26, "priority": 0}', "BadMessage", "priority"),
        ('{"value": 26, "priority": 8.5}', "BadMessage", "priority"),
        ('{"value": 26, "duration_s": -1}', "BadMessage", "duration_s"),
        ('{"value": 26, "valu": 1}', "BadMessage", "valu"),
        ("[" * 3000, "BadMessage", "neither"),
        ("1" * 5000, "BadMessage", "at most 4096"),
    ],
)
def test_mqtt_gateway__invalid_commands_are_answered_and_move_nothing(
    bus: Bus, served: RunningGateway, broker: Broker, payload: str, error: str, text: str
) -> None:
    with broker.subscribed("zenostat/office/actuator/+/result") as messages:
        broker.publish(f"zenostat/office/actuator/{COOLING}/set", payload)
        answer = result(messages, 1)
        assert (answer["accepted"], answer["error"]) == (False, error)
        assert text in answer["message"]
    assert all(entry.value is None for array in bus.priorities("office").values() for entry in array)


def test_mqtt_gateway__unknown_actuator_is_answered_with_similar_names(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    with broker.subscribed("zenostat/office/actuator/+/result") as messages:
        broker.publish("zenostat/office/actuator/core_zn_coolin_setpoint/set", "26")
        assert "did you mean" in result(messages, 1, "core_zn_coolin_setpoint")["message"]


def test_mqtt_gateway__retained_command_is_not_carried_out(bus: Bus, broker: Broker) -> None:
    endpoint = bus.endpoint
    topic = f"second/actuator/{COOLING}/set"
    broker.publish(topic, "26.5", retain=True)
    options = ["--topic", "second", "--source", "second", "--mqtt-version", "3.1.1"]
    options += ["--broker", f"127.0.0.1:{broker.port_v3}"]
    with broker.subscribed("second/actuator/+/result") as messages, gateway(endpoint, broker, *options):
        until(lambda: payloads(messages, f"second/actuator/{COOLING}/result"), "it is answered")
        assert "retained" in payloads(messages, f"second/actuator/{COOLING}/result")[0]
        assert bus.priorities("office")[COOLING][7].value is None
        broker.publish(topic, "", retain=True)  # and with the retained message gone, the topic commands again
        broker.publish(topic, "25.5")
        until(lambda: bus.priorities("office")[COOLING][7].value == 25.5, "the command is carried out")
    assert broker.retained("second/status") == "offline"


def test_mqtt_gateway__mqtt_5_client_gets_the_result_where_it_wants_it(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    properties = Properties(PacketTypes.PUBLISH)
    properties.ResponseTopic = "answers/7"
    with broker.subscribed("answers/7") as messages:
        broker.publish(f"zenostat/office/actuator/{COOLING}/set", "26.0", properties=properties)
        until(lambda: messages, "it is answered")
    assert json.loads(messages[0][1])["accepted"]


def test_mqtt_gateway__response_topic_that_is_none_costs_the_other_clients_nothing(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    topic = f"zenostat/office/actuator/{COOLING}"
    answers = ["a/#", "+", "", "x" * 65_000, f"{topic}/set", "right"]
    with broker.subscribed("zenostat/office/actuator/+/result") as messages:
        for number, answer in enumerate(answers):
            properties = Properties(PacketTypes.PUBLISH)
            properties.ResponseTopic = answer
            broker.publish(f"{topic}/set", str(25.0 + number / 10), properties=properties)
        until(lambda: len(payloads(messages, f"{topic}/result")) == len(answers), "all are answered")
        accepted = [json.loads(line)["accepted"] for line in payloads(messages, f"{topic}/result")]
        assert accepted == [answer != f"{topic}/set" for answer in answers]
    assert bus.priorities("office")[COOLING][7].value == 25.5
    assert served.program.poll() is None


def test_mqtt_gateway__response_topic_of_the_gateway_is_rejected_and_nothing_is_published_there(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    root, own = "zenostat/office", f"zenostat/office/actuator/{COOLING}/result"
    refused = [root, f"{root}/status", f"{root}/sensor/{TEMPERATURE}", f"{own}/x", "homeassistant/sensor/x/config"]
    refused.append("zenostat/other/status")  # another gateway's
    answers = [*refused, "replies/7", own]
    with broker.subscribed("#") as messages:
        for number, answer in enumerate(answers):
            properties = Properties(PacketTypes.PUBLISH)
            properties.ResponseTopic, properties.CorrelationData = answer, bytes([number])
            broker.publish(f"{root}/actuator/{COOLING}/set", str(25.0 + number / 10), properties=properties)
        until(lambda: len(payloads(messages, own)) == len(answers), "each has one result")
        until(lambda: payloads(messages, "replies/7"), "a topic that is not below the gateways' is the client's")
        results = [json.loads(line) for line in payloads(messages, own)]
        assert [result["accepted"] for result in results] == [False] * len(refused) + [True, True]
        for answer, rejected in zip(refused, results, strict=False):
            assert f"response topic {answer!r} is a gateway's own" in rejected["message"]
            assert not any("accepted" in line for line in payloads(messages, answer))
    assert bus.priorities("office")[COOLING][7].value == 25.7


@pytest.mark.slow
@needs_mosquitto
def test_mqtt_gateway__response_topic_for_which_the_broker_ends_the_connection_is_given_up(
    bus: Bus, broker: Broker
) -> None:
    topic = f"levels/actuator/{COOLING}"
    properties = Properties(PacketTypes.PUBLISH)
    properties.ResponseTopic = "/" * 300  # mosquitto has at most 200 levels
    options = ["--topic", "levels", "--source", "levels"]
    with broker.subscribed("levels/actuator/+/result") as messages, gateway(bus.endpoint, broker, *options):
        until(lambda: broker.retained("levels/status") == "online", "it is online")
        broker.publish(f"{topic}/set", "26", properties=properties)

        def is_answered() -> bool:
            broker.publish(f"{topic}/set", "27")
            return any('"value": 27.0' in line for line in payloads(messages, f"{topic}/result"))

        until(is_answered, "a later command is answered")


@needs_mosquitto
def test_mqtt_gateway__retained_command_is_rejected_while_the_gateway_is_connected_too(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    topic = f"zenostat/office/actuator/{COOLING}"
    with broker.subscribed("zenostat/office/actuator/+/result") as messages:
        broker.publish(f"{topic}/set", "26.5", retain=True)
        assert "retained" in result(messages, 1)["message"]
        broker.publish(f"{topic}/set", "", retain=True)
        assert not result(messages, 2)["accepted"]
    assert bus.priorities("office")[COOLING][7].value is None


@needs_mosquitto
def test_mqtt_gateway__messages_that_the_broker_rejects_are_named_once_and_not_counted(
    bus: Bus, tmp_path: Path
) -> None:
    root = "zenostat/office"
    (tmp_path / "acl").write_text(f"topic read {root}/#\ntopic write {root}/actuator/+/set\n")
    (tmp_path / "acl").chmod(0o600)
    # Without a limit, mosquitto 2.0.11 ends the connection after a message that it rejects.
    settings = ["user root", f"acl_file {tmp_path / 'acl'}", "max_queued_messages 1000"]
    options = ["--connect", bus.endpoint, "--source", "restricted"]
    with (
        Broker(tmp_path, settings=settings) as broker,
        RunningGateway("mqtt", "office", *options, "--broker", f"127.0.0.1:{broker.port}") as running,
    ):

        def is_carried_out() -> bool:
            broker.publish(f"{root}/actuator/{COOLING}/set", "26.5")  # it may not listen yet
            return bus.priorities("office")[COOLING][7] == (26.5, "restricted")

        until(is_carried_out, "a command is carried out")
        bus.step("office")
        lines = []
        for line in running.program.stderr:
            lines.append(line)
            if f"'{root}/sample'" in line:
                break
        _, out, err = running.end()
    text = "".join([*lines, err])
    assert "0 samples published" in out
    assert " 0 commands accepted" not in out
    for topic in ("manifest", "status", "sample", f"sensor/{TEMPERATURE}", f"actuator/{COOLING}/result"):
        assert text.count(f"rejects a message on '{root}/{topic}' (Not authorized)") == 1, text


def test_mqtt_gateway__key_without_a_certificate_is_refused() -> None:
    with pytest.raises(InvalidConfig, match=r"key.pem: a client's key without its certificate"):
        GatewayBroker("127.0.0.1", 8883, tls=aiomqtt.TLSParameters(keyfile="key.pem"))


@pytest.mark.slow
def test_mqtt_gateway__commands_that_wait_when_the_gateway_ends_have_a_result(tmp_path: Path) -> None:
    plant = f"{Path(__file__).parents[2]}/examples/own_plant.py:HeatPumpRoom"

    async def main(node: NodeProgram, port: int) -> None:
        async with aiomqtt.Client("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V5) as other:
            await other.subscribe("zenostat/room/+/+/result", qos=1)
            with open_session(connect=[node.endpoint]) as session:
                async with (
                    NodeClient(session, "room", source="mqtt") as client,
                    MqttGateway(client, GatewayBroker("127.0.0.1", port)) as gateway,
                ):
                    running = asyncio.create_task(gateway.run())
                    os.kill(node.pid, signal.SIGSTOP)
                    while gateway.waiting < 2:  # the gateway subscribes meanwhile
                        await other.publish("zenostat/room/actuator/compressor/set", "500", qos=1)
                        await asyncio.sleep(0.05)
                    await cancel(running, retry_s=60.0)
            results.extend([json.loads((await anext(other.messages)).payload) for _ in range(gateway.counts.rejected)])

    results: list[dict[str, Any]] = []
    with Broker(tmp_path) as broker, NodeProgram(tmp_path / "room", plant=plant, name="room") as node:
        try:
            asyncio.run(main(node, broker.port))
        finally:
            os.kill(node.pid, signal.SIGCONT)
    assert [entry["error"] for entry in results] == ["NodeLost", *["RequestRejected"] * (len(results) - 1)]
    assert "may take effect" in results[0]["message"]
    assert len(results) >= 3


def test_mqtt_gateway__home_assistant_finds_each_point(bus: Bus, served: RunningGateway, broker: Broker) -> None:
    manifest = bus.manifest("office")
    sensor = json.loads(broker.retained(f"homeassistant/sensor/zenostat_office_{TEMPERATURE}/config") or "")
    assert (sensor["unit_of_measurement"], sensor["device_class"]) == ("°C", "temperature")
    assert sensor["state_topic"] == f"zenostat/office/sensor/{TEMPERATURE}"
    actuator = next(a for a in manifest.actuators if a.name == COOLING)
    number = json.loads(broker.retained(f"homeassistant/number/zenostat_office_{COOLING}/config") or "")
    assert (number["min"], number["max"]) == (actuator.low, actuator.high)
    assert number["command_topic"] == f"zenostat/office/actuator/{COOLING}/set"
    climate = json.loads(broker.retained(f"homeassistant/climate/zenostat_office_climate_{TEMPERATURE}/config") or "")
    assert climate["temperature_high_command_topic"] == number["command_topic"]
    assert climate["current_temperature_topic"] == sensor["state_topic"]


def test_mqtt_gateway__home_assistant_sends_only_values_that_are_accepted_and_relinquishes(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    jinja2 = pytest.importorskip("jinja2")
    actuators = {actuator.name: actuator for actuator in bus.manifest("office").actuators}
    climate = json.loads(broker.retained(f"homeassistant/climate/zenostat_office_climate_{TEMPERATURE}/config") or "")
    count = 0
    with broker.subscribed("zenostat/office/actuator/+/result") as messages:
        for side in ("low", "high"):
            topic = climate[f"temperature_{side}_command_topic"]
            actuator = actuators[topic.split("/")[-2]]
            template = jinja2.Template(climate[f"temperature_{side}_command_template"])
            for value in (climate["min_temp"], 21.5, climate["max_temp"]):  # all that its slider can be set to
                broker.publish(topic, template.render(value=value))
                count += 1
                done = result(messages, (count - 1) % 3 + 1, actuator.name)
                assert done["value"] == min(max(value, actuator.low), actuator.high)
            button = json.loads(broker.retained(f"homeassistant/button/{button_id(actuator.name)}/config") or "")
            broker.publish(button["command_topic"], button["payload_press"])
            until(lambda name=actuator.name: bus.priorities("office")[name][7].value is None, "it is relinquished")


def button_id(actuator: str) -> str:
    return f"zenostat_office_{actuator}_relinquish"


@pytest.mark.slow
def test_mqtt_gateway__flood_of_commands_is_answered_one_by_one(
    bus: Bus, served: RunningGateway, broker: Broker
) -> None:
    """Values out of the bounds among valid ones: none of them arrives, and the last valid one is in effect."""
    topic = f"zenostat/office/actuator/{COOLING}"
    commands = [str(24.0 + 0.001 * i) if i % 3 else "1000" for i in range(1500)]
    with broker.subscribed("zenostat/office/actuator/+/result") as messages:
        broker.publish(f"{topic}/set", *commands)
        until(lambda: len(payloads(messages, f"{topic}/result")) >= 1500, "each has a result")
        answers = [json.loads(line) for line in payloads(messages, f"{topic}/result")]
        done = [answer["value"] for answer in answers if answer["accepted"]]
        assert len(answers) == 1500
        valid = iter([float(p) for p in commands if p != "1000"])
        assert all(value in valid for value in done)  # in order; others were told that too many are waiting
        assert len(done) >= 600
        assert bus.priorities("office")[COOLING][7].value == done[-1]


@pytest.mark.slow
def test_mqtt_gateway__broker_that_returns_has_everything_again_and_no_result_is_lost(bus: Bus, tmp_path: Path) -> None:
    topic = f"zenostat/office/actuator/{COOLING}"
    with Broker(tmp_path) as broker, gateway(bus.endpoint, broker, "--source", "returning"):
        until(lambda: broker.retained("zenostat/office/status") == "online", "it is online")
        broker.stop()
        bus.step("office")
        broker.start()
        until(lambda: broker.retained("zenostat/office/status") == "online", "it is online again")
        with broker.subscribed("zenostat/office/actuator/+/result") as messages:
            broker.publish(f"{topic}/set", "26.5")
            assert result(messages, 1)["accepted"]
        latest = str(bus.read("office")[TEMPERATURE])
        until(lambda: broker.retained(f"zenostat/office/sensor/{TEMPERATURE}") == latest, "values are there again")


def test_mqtt_gateway__example_sets_back_at_night(bus: Bus, served: RunningGateway, broker: Broker) -> None:
    example = Path(__file__).parents[2] / "examples" / "mqtt_client.py"
    command = [sys.executable, "-u", str(example), "--port", str(broker.port_v3)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout.readline() == "subscribed\n"
        until(
            lambda: bus.step("office") or bus.priorities("office")[COOLING][7] == (28.0, "mqtt.night_setback"),
            "at night",
        )
        bus.resume("office")
        out, _ = program.communicate(timeout=60)
    assert program.returncode == 0
    times = [line.split(": ") for line in out.splitlines() if "2" in line[:1]]
    assert [(time[11:16], what) for time, what in times[1:]] == [("06:00", "day"), ("20:00", "night")]


@pytest.mark.parametrize("other", ["annex", "office"])
def test_mqtt_gateway__topic_of_another_nodes_gateway_is_refused(
    bus: Bus, served: RunningGateway, broker: Broker, tmp_path: Path, other: str
) -> None:
    """Also if the other node has the same name, on another bus, where no gateway can see the first one."""
    until(lambda: broker.retained("zenostat/office/status") == "online", "it is online")
    values = f"zenostat/office/sensor/{TEMPERATURE}", "zenostat/office/manifest", "zenostat/office/status"
    before = [broker.retained(topic) for topic in values]
    arguments = ("--broker", f"127.0.0.1:{broker.port}", "--topic", "zenostat/office")
    with NodeProgram(tmp_path / "other", plant=PLANT, name=other) as node:
        done = run_in_process("gateway", "mqtt", other, "--connect", node.endpoint, *arguments)
        assert done.returncode == 1
        assert "a gateway of node 'office' publishes below zenostat/office/ on the broker" in done.stderr
        assert "choose another topic with --topic" in done.stderr
        assert [broker.retained(topic) for topic in values] == before
        broker.publish("annex/status", "online", retain=True)  # of a gateway that ended while the broker was away
        broker.publish("annex/manifest", "no JSON", retain=True)
        with RunningGateway("mqtt", other, "--connect", node.endpoint, *arguments[:2], "--topic", "annex"):
            until(lambda: "actuators" in (broker.retained("annex/manifest") or ""), "it is served under another topic")


def test_mqtt_gateway__command_that_a_snapshot_brings_back_is_relinquished_at_the_end(bus: Bus, broker: Broker) -> None:
    command = f"fourth/actuator/{COOLING}/set"
    with gateway(bus.endpoint, broker, "--topic", "fourth", "--source", "fourth"):
        until(lambda: broker.retained("fourth/status") == "online", "it is online")
        broker.publish(command, "27")
        until(lambda: bus.priorities("office")[COOLING][7] == (27.0, "fourth"), "it is commanded")
        snapshot = bus.snapshot("office").snapshot
        broker.publish(command, "null")
        until(lambda: bus.priorities("office")[COOLING][7].value is None, "it is relinquished")
        bus.reset("office", Reset(snapshot=snapshot))
        until(lambda: bus.priorities("office")[COOLING][7] == (27.0, "fourth"), "it is back")
    assert bus.priorities("office")[COOLING][7].value is None


def test_mqtt_gateway__killed_gateway_is_offline_by_its_last_will(bus: Bus, broker: Broker) -> None:
    options = ["--topic", "third", "--source", "third", "--broker", f"127.0.0.1:{broker.port}"]
    with RunningGateway("mqtt", "office", "--connect", bus.endpoint, *options):
        until(lambda: broker.retained("third/status") == "online", "it is online")
    until(lambda: broker.retained("third/status") == "offline", "the broker has published the last will")


def test_mqtt_gateway__tls_and_password(bus: Bus, tmp_path: Path) -> None:
    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], cwd=tmp_path, check=True, capture_output=True)

    openssl(
        "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout", "key.pem",
        "-out", "cert.pem", "-days", "2", "-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1",
    )  # fmt: skip
    (tmp_path / "key.pem").chmod(0o644)
    tmp_path.chmod(0o755)
    security = Security("gateway", "secret", tmp_path / "cert.pem", tmp_path / "key.pem")
    (tmp_path / "password").write_text("secret\n")
    secured = ["--tls", "--ca", str(tmp_path / "cert.pem"), "--username", "gateway", "--source", "secured"]
    secured += ["--password-file", str(tmp_path / "password")]
    with Broker(tmp_path, security) as broker:
        with gateway(bus.endpoint, broker, *secured):
            until(lambda: broker.retained("zenostat/office/status") == "online", "it is online")
        (tmp_path / "password").write_text("wrong")
        address = ["--connect", bus.endpoint, "--broker", f"127.0.0.1:{broker.port}"]
        done = run_in_process("gateway", "mqtt", "office", *address, *secured)
    assert done.returncode != 0
    assert ("Not authorized" if BROKER == "mosquitto" else "no connection") in done.stderr
    assert len(done.stderr.splitlines()) == 1
