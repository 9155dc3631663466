"""Recordings whose messages somebody has changed, with checksums that fit: each change is found or named."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
from support.nodes import node_on_bus, until
from support.recordings import rewrite
from support.run_cli import run_in_process as run

from zenostat.bridge.recording.reader import RecordedItem
from zenostat.bridge.transport.session import open_session
from zenostat.topics.messages import Flag

PLANT = "zenostat.agent_sdk.testing.fake_plant:FakePlant"
FAULTS = {"faults": [{"kind": "bias", "points": "*", "offset": 5.0}]}

Fields = dict[str, Any]


@pytest.fixture(scope="module")
def recorded(module_folder: Path) -> Path:
    """A recording of a few steps with a controller, a write and an injected fault."""
    path = module_folder / "room.mcap"
    with (
        node_on_bus(module_folder / "node", plant=PLANT, name="room", record=str(path)) as (_, bus),
        bus.controller("room", name="agent") as link,
    ):
        bus.faults("room", FAULTS, source="ann")
        sample = link.reset(seed=1)
        actuators = [actuator.name for actuator in link.manifest.actuators]
        for step in range(4):
            if step == 2:
                bus.write("room", actuators[1], 25.0, source="ann")
            sample.send({actuators[0]: 20.0 + step / 2})
            sample = link.receive()
        bus.stop_recording("room")
    return path


def edited(source: Path, target: Path, schema: str, change: Callable[[Fields], Any]) -> Path:
    """Copy a recording with the fields of all messages of a class changed."""

    def changed(_: int, item: RecordedItem) -> bytes:
        if item.schema != schema:
            return item.payload
        payload: bytes = msgpack.packb(change(msgpack.unpackb(item.payload)))
        return payload

    return rewrite(source, target, changed)


def verified(path: Path) -> Any:
    return run("verify", str(path), "--plant", PLANT, columns=1000)


def test_verify__recording_as_it_was_written_passes(recorded: Path) -> None:
    result = verified(recorded)
    assert result.returncode == 0, result.stderr
    assert "identical: 4 steps" in result.stdout


SAMPLE_EDITS: dict[str, Callable[[Fields], Fields]] = {
    "sources renamed": lambda s: s | {"sources": [name.replace("ann", "bob") for name in s["sources"]]},
    "commanded changed": lambda s: s | {"commanded": bytes(len(s["commanded"]))},
    "late commands": lambda s: s | {"late": 99},
    "fallback": lambda s: s | {"flags": [flags | Flag.FALLBACK for flags in s["flags"]]},
    "published values": lambda s: s | {"values": s["fault_free_values"] or s["values"]},
}


@pytest.mark.parametrize("change", SAMPLE_EDITS.values(), ids=SAMPLE_EDITS)
def test_verify__fields_that_no_simulation_repeats_are_covered_by_the_chain(
    recorded: Path, tmp_path: Path, change: Callable[[Fields], Fields]
) -> None:
    result = verified(edited(recorded, tmp_path / "edited.mcap", "Sample", change))
    assert result.returncode == 1
    assert "audit log: broken: samples, orders or the weather from" in result.stdout


WRONG_SHAPES: dict[str, tuple[str, Callable[[Fields], Any], str]] = {
    "no map": ("Sample", lambda _: [1], "sample: a Sample should be a map"),
    "list of values": ("Sample", lambda s: s | {"values": [1.0, 2.0]}, "sample: Sample: values: "),
    "values cut": ("Sample", lambda s: s | {"values": s["values"][:8]}, "sample: values has 8 bytes; "),
    "effective cut": ("Sample", lambda s: s | {"effective": b""}, "sample: effective has 0 bytes; "),
    "no episode": ("Sample", lambda s: s | {"episode": []}, "sample: episode has 0 entries; 1 expected"),
    "no time": ("Sample", lambda s: s | {"time": ["soon"]}, "sample: time: 'soon' is no date and time"),
    "no source": ("Sample", lambda s: s | {"sources": []}, "source_index refers to more than its 0 sources"),
    "order cut": ("RecordedOrder", lambda o: o | {"values": b""}, "orders: values has 0 bytes; "),
    "order of slot 7": ("RecordedOrder", lambda o: o | {"slots": [7]}, "[7] are no slots of a node that has 1"),
    "episode of slot 7": ("RecordedEpisode", lambda e: e | {"slots": [7]}, "[7] are no slots of a node that has 1"),
    "episode without seed": ("RecordedEpisode", lambda e: e | {"seeds": []}, "seeds has 0 entries; 1 expected"),
}


@pytest.mark.parametrize("case", WRONG_SHAPES.values(), ids=WRONG_SHAPES)
def test_verify_and_replay__name_a_message_of_a_wrong_shape(
    recorded: Path, tmp_path: Path, case: tuple[str, Callable[[Fields], Any], str]
) -> None:
    schema, change, text = case
    path = edited(recorded, tmp_path / "edited.mcap", schema, change)
    commands = [("verify", str(path), "--plant", PLANT)]
    if schema == "Sample":
        endpoint = f"unixsock-stream/{tmp_path}/bus"
        commands.append(("replay", str(path), "--listen", endpoint, "--speed", "1000000"))
    for command in commands:
        result = run(*command, columns=1000)
        assert result.returncode == 2
        assert f"{path} is damaged: " in result.stderr
        assert text in result.stderr
        assert "Traceback" not in result.stderr


def test_log__cuts_a_rejected_value_of_megabytes(module_folder: Path) -> None:
    path = module_folder / "long.mcap"
    with node_on_bus(module_folder / "other", plant=PLANT, name="room", record=str(path)) as (node, bus):
        key = f"zenostat/v3/room/actuator/ann/{bus.manifest('room').actuators[0].name}"
        with open_session(connect=[node.endpoint]) as stranger:
            stranger.put(key, msgpack.packb({"value": "x" * 3_000_000}))
            until(lambda: bus.status("room").rejected, "the node has rejected it")
        bus.stop_recording("room")
    result = run("log", str(path), columns=200)
    assert result.returncode == 0
    assert len(result.stdout) < 10_000
    assert "x" * 100 in result.stdout.replace("\n", "").replace(" ", "")
