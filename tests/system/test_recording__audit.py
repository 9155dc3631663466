"""The audit log of a recorded node with keys: who, by which way in, proven by what; and what was removed from it."""

import json
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import mcap.reader
import mcap.writer
import pytest
from pymodbus.client import ModbusTcpClient
from support.certificates import house_keys
from support.gateways import RunningGateway
from support.nodes import NodeProgram, free_port
from support.run_cli import run_in_process as run

import zenostat
from zenostat import recording
from zenostat.bridge.recording.audit_chain import check_audit
from zenostat.bridge.recording.reader import RecordingReader
from zenostat.bridge.transport.certificates import add
from zenostat.eplus_node.verify_recording import verify
from zenostat.topics import recording as recording_format
from zenostat.topics.keys import Role

PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"


@pytest.fixture(scope="module")
def recorded(module_folder: Path) -> Any:
    """A recording of an episode with a controller, a person, and a Modbus client; and the actuators' names."""
    folder = house_keys(module_folder / "keys")
    add(folder, (Role.CONTROLLER, Role.OPERATOR), "ann")
    clients = module_folder / "clients.yaml"
    clients.write_text("clients:\n  panel: {modbus: {unit: 5}, allow: ['*']}\n")
    path = module_folder / "room.mcap"
    listen = [f"tls/127.0.0.1:{free_port()}"]
    with (
        NodeProgram(module_folder / "node", plant=PLANT, name="room", listen=listen, keys=str(folder)) as node,
        zenostat.connect(node.endpoint, keys=folder / "ann.pem", affinity="off") as bus,
    ):
        bus.record("room", path)
        names = [actuator.name for actuator in bus.manifest("room").actuators]
        with bus.controller("room", name="agent") as link:
            sample = link.reset(seed=1)
            for _ in range(3):
                sample.send({names[0]: 21.0})
                sample = link.receive()
            bus.write("room", names[1], 25.0, source="screen")
            bus.faults("room", {"faults": [{"kind": "noise", "points": "*", "sigma": 0.1}]}, source="screen")
            options = ("--connect", node.endpoint, "--keys", str(folder), "--clients", str(clients))
            with (
                RunningGateway("modbus", "room", "--address", "127.0.0.1:0", *options) as gateway,
                ModbusTcpClient("127.0.0.1", port=gateway.port, timeout=20) as device,
            ):
                registers = list(struct.unpack(">HH", struct.pack(">f", 24.0)))
                assert not device.write_registers(2, registers, device_id=5).isError()
                gateway.end()
            bus.pause("room", source="screen")
            bus.resume("room", source="screen")
        bus.stop_recording("room")
    return SimpleNamespace(path=path, names=names)


@pytest.mark.slow
def test_log__has_the_proven_name_and_the_way_in_of_each_sender(recorded: Any) -> None:
    log = recording.load(recorded.path).log
    (agent,) = [entry for entry in log if entry.kind == "command"]
    assert (agent.proven, agent.via, agent.count) == ("ann", "zenoh", 3)
    assert agent.source.startswith("ann.agent")
    by_modbus, by_ann = [[e for e in log if e.kind == "write" and e.via == via] for via in ("modbus", "zenoh")]
    assert [(entry.source, entry.proven) for entry in by_ann] == [("ann.screen", "ann")]
    # The command, and the gateway's relinquishment at its end. The certificate proves the gateway alone.
    assert [(entry.source, entry.proven) for entry in by_modbus] == [("gateway.modbus.panel", "gateway")] * 2
    assert all(entry.proven for entry in log)
    faults = [entry for entry in log if entry.kind == "faults"]
    assert [entry.source for entry in faults] == ["ann.screen"]
    events = [event for _, event in recording.load(recorded.path).events]
    assert [event.source for event in events if event.text.startswith("faults are set")] == ["ann.screen"]
    printed = json.loads(run("log", str(recorded.path), "--source", "gateway.*", "--json").stdout)
    assert {(row["proven"], row["via"]) for row in printed} == {("gateway", "modbus")}


@pytest.mark.slow
def test_verify__whole_audit_log_is_unbroken(recorded: Any) -> None:
    with RecordingReader(recorded.path) as reader:
        result = check_audit(reader)
    assert result.problems == []
    assert result.entries > 10
    done = run("verify", str(recorded.path), "--audit-only")
    assert (done.returncode, done.stdout) == (0, f"{result}\n")


def without(
    source: Path, target: Path, drop: Callable[[int, str], bool], attached: Mapping[str, bytes] = MappingProxyType({})
) -> Path:
    """Write a recording anew with MCAP's own library, without some messages, and with some attachments replaced."""
    with source.open("rb") as file, target.open("wb") as out:
        reader = mcap.reader.make_reader(file)
        writer = mcap.writer.Writer(out)
        header = reader.get_header()
        writer.start(header.profile, header.library)
        for metadata in reader.iter_metadata():
            if metadata.name != recording_format.SUMMARY:
                writer.add_metadata(metadata.name, metadata.metadata)
        for attachment in reader.iter_attachments():
            data = attached.get(attachment.name, attachment.data)
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, data)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        sequence = 0
        for number, (schema, channel, message) in enumerate(reader.iter_messages(log_time_order=False)):
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            if drop(number, channel.topic):
                continue
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, sequence=sequence
            )
            sequence += 1
        writer.finish()
    return target


@pytest.mark.slow
def test_verify__line_that_was_removed_with_the_mcap_library_is_named(recorded: Any, tmp_path: Path) -> None:
    with RecordingReader(recorded.path) as reader:
        topics = [item.topic for item in reader.messages()]
        entries = check_audit(reader).entries
    write = f"rpc/write/ann.screen/{recorded.names[1]}"
    (removed,) = [number for number, topic in enumerate(topics) if topic == write]
    copy = without(recorded.path, tmp_path / "copy.mcap", lambda *_: False)
    with RecordingReader(copy) as reader:
        result = check_audit(reader)
    assert (result.problems, result.entries) == ([], entries)  # a copy of everything is unbroken

    cut = without(recorded.path, tmp_path / "cut.mcap", lambda number, _: number == removed)
    values = ("sample", "orders", "weather", "audit")
    position = 1 + sum(topic not in values for topic in topics[:removed])
    previous = next(topic for topic in reversed(topics[:removed]) if topic not in values)
    done = run("verify", str(cut), "--audit-only")
    assert done.returncode == 1
    assert done.stdout.startswith(f"audit log: broken: entry {position} is missing, after {previous} at 20")
    result = verify(cut, plant=PLANT)
    assert not result.passed
    assert result.difference is None  # the values are those of the plant; only the audit log is not whole
    assert len(result.audit.problems) == 1
    shown = run("log", str(cut))
    assert f"entry {position} is missing" in shown.stderr
    assert shown.returncode == 0

    scenario = {recording_format.SCENARIO: b"id: of-somebody-else"}
    other = without(recorded.path, tmp_path / "other.mcap", lambda *_: False, scenario)
    done = run("verify", str(other), "--audit-only")
    assert done.returncode == 1
    assert done.stdout.startswith("audit log: broken: what the file has before its messages has changed")

    audit = without(recorded.path, tmp_path / "audit.mcap", lambda _, topic: topic.endswith("/audit"))
    with RecordingReader(audit) as reader:
        assert "have no digest" in str(check_audit(reader))
