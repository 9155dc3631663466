"""A run that EnergyPlus completes with severe errors: what the user learns of it."""

import json
import warnings
from pathlib import Path

import pytest
import zenoh
from support.nodes import SMALL, NodeProgram, until
from support.run_cli import run_in_process

from zenostat import connect
from zenostat.lab.evaluate import evaluate
from zenostat.models.building.model import read_building
from zenostat.models.catalog import find_building
from zenostat.topics import codec, keys
from zenostat.topics.messages import Event, EventKind


@pytest.fixture
def mixers(scratch: Path) -> dict[str, str]:
    """Names and outdoor air nodes of mixers without outdoor air: EnergyPlus reports each as severe, and goes on."""
    objects = read_building(find_building(SMALL["building"])).objects
    kept = {kind: items for kind, items in objects.items() if kind != "OutdoorAir:NodeList"}
    (scratch / "mixers.epJSON").write_text(json.dumps(kept))
    scenario = {**SMALL, "building": str(scratch / "mixers.epJSON")}
    (scratch / "scenario.yaml").write_text(json.dumps(scenario))
    return {name: fields["outdoor_air_stream_node_name"] for name, fields in objects["OutdoorAir:Mixer"].items()}


def _check(texts: list[str], mixers: dict[str, str]) -> None:
    reported = sorted(text for text in texts if "Node Connection Error" in text)
    assert len(reported) == len(mixers)
    for text, (name, node) in zip(reported, sorted(mixers.items()), strict=True):
        assert text.startswith(f'EnergyPlus reports a severe error: Node Connection Error, Node="{node.upper()}"')
        assert name.upper() in text
    assert f"EnergyPlus counts {len(mixers)} severe errors in this run" in texts


def test_severe_errors__evaluation_has_each_once(mixers: dict[str, str], scratch: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the model's nodes
        reported = evaluate(scratch / "scenario.yaml", ["baseline"], episodes=2).warnings
    assert list(reported) == ["baseline"]
    assert len(reported["baseline"]) == len(mixers) + 1
    _check(reported["baseline"], mixers)


def test_severe_errors__are_below_the_table_of_evaluate(mixers: dict[str, str], scratch: Path) -> None:
    done = run_in_process("evaluate", "scenario.yaml", "--controller", "baseline", cwd=scratch, columns=1000)
    lines = done.stdout.splitlines()
    _check([line.removeprefix("warning: baseline: ") for line in lines if line.startswith("warning:")], mixers)


def test_severe_errors__each_episode_has_their_events(mixers: dict[str, str], scratch: Path) -> None:
    events: list[Event] = []

    def receive(sent: zenoh.Sample) -> None:
        events.append(codec.decode(Event, sent.payload.to_bytes()))

    settings = json.loads((scratch / "scenario.yaml").read_text())
    with (
        NodeProgram(scratch / "node", **settings) as node,
        connect(node.endpoint) as bus,
        bus.session.declare_subscriber(keys.EVENT.at(node.name), receive),
    ):
        for episode in (1, 2):
            with bus.controller(node.name) as link:
                link.reset()
                for sample in link:
                    sample.send({})
            until(lambda number=episode: EventKind.ENDED in {e.kind for e in events if e.episode == number}, "the end")
            warned = [event for event in events if event.kind is EventKind.WARNING]
            assert {event.episode for event in warned} == {episode}
            _check([event.text for event in warned], mixers)
            events.clear()
