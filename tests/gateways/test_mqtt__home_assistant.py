"""Discovery messages of Home Assistant: each point has an id of its own."""

import json
import math
from collections.abc import Sequence

import pytest
from support.builders import manifest, sensor

from zenostat.gateways.mqtt.home_assistant import discovery, discovery_topics, is_discovery
from zenostat.gateways.mqtt.messages import number
from zenostat.topics.messages import Actuator, Sensor

ROOT = "zenostat/office"


def ids(sensors: Sequence[str], actuators: Sequence[str] = ()) -> dict[str, str]:
    """The id in the topic of each point's message, by the topic of its values."""
    described = manifest(
        sensors=[Sensor(name=name, unit="degC") for name in sensors],
        actuators=[Actuator(name=name, unit="degC") for name in actuators],
    )
    by_topic = {}
    for topic, text in discovery(described, ROOT):
        content = json.loads(text)
        _, component, identifier, _ = topic.split("/")
        assert content["unique_id"] == identifier
        assert f"homeassistant/{component}/+/config" in discovery_topics("homeassistant")
        assert is_discovery(text.encode(), ROOT)
        by_topic[content.get("state_topic", topic)] = identifier
    return by_topic


def test_home_assistant__names_that_differ_in_a_dot_have_ids_of_their_own() -> None:
    alone = ids(["zone_T", "other"], ["valve"])
    both = ids(["zone.T", "zone_T", "other"], ["valve.a", "valve_a"])
    assert len({*both.values()}) == len(both) == 7
    assert both[f"{ROOT}/sensor/zone_T"] == alone[f"{ROOT}/sensor/zone_T"] == "zenostat_office_zone_T"
    assert both == ids(["zone_T", "other", "zone.T"], ["valve_a", "valve.a"]), "whatever the order"
    assert ids(["zone.T"])[f"{ROOT}/sensor/zone.T"] == "zenostat_office_zone_T"


@pytest.mark.parametrize("unit", ["W", "kW", "MW"])
def test_home_assistant__powers_have_their_unit_and_class(unit: str) -> None:
    ((_, text),) = discovery(manifest(sensors=[Sensor(name="power", unit=unit)]), ROOT)
    content = json.loads(text)
    assert (content["unit_of_measurement"], content["device_class"]) == (unit, "power")


def test_home_assistant__gateways_of_one_broker_have_ids_of_their_own() -> None:
    """A node's name does not tell apart two sites, which have topics of their own, and dots are no part of an id."""
    roots = [("office", ROOT), ("office", "site/office"), ("site.a", "zenostat/site.a"), ("site_a", "zenostat/site_a")]
    published = [
        {topic for topic, _ in discovery(manifest(sensors=[sensor("t")]).model_copy(update={"node": node}), root)}
        for node, root in roots
    ]
    assert len(set().union(*published)) == len(roots)
    devices = {
        json.loads(text)["device"]["identifiers"][0]
        for node, root in roots
        for _, text in discovery(manifest(sensors=[sensor("t")]).model_copy(update={"node": node}), root)
    }
    assert len(devices) == len(roots)
    assert {"zenostat_office", "zenostat_site_a"} < devices


def test_home_assistant__value_that_is_unknown_is_its_own_word_for_it() -> None:
    """Its sensors take `None` for unknown, and its numbers what is set as `payload_reset`."""
    jinja2 = pytest.importorskip("jinja2")
    described = manifest(
        sensors=[Sensor(name="zone", unit="degC")], actuators=[Actuator(name="valve", unit="fraction")]
    )
    contents = {topic.split("/")[1]: json.loads(text) for topic, text in discovery(described, ROOT)}
    template = jinja2.Template(contents["sensor"]["value_template"])
    assert [template.render(value=number(value)) for value in (math.nan, None, 21.5, 1e-7)] == [
        "None",
        "None",
        "21.5",
        "1e-07",
    ]
    assert contents["number"]["payload_reset"] == number(None)


def test_home_assistant__other_messages_are_not_taken_for_those_of_a_gateway() -> None:
    for payload in (b"", b"\xff", b"[" * 100_000, b"[]", b"{}", b'{"availability_topic": "zenostat/office_2/status"}'):
        assert not is_discovery(payload, ROOT)
