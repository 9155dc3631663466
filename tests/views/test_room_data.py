"""Data of the control room: floor plans, descriptions, numbers, requested changes, and the stream of changes."""

import asyncio
import json
import math

import numpy as np
import pytest
from support.builders import actuator, manifest, meter, sensor, view
from support.clock import Clock

pytest.importorskip("starlette")

from zenostat.bridge.client.history import History
from zenostat.topics.errors import InvalidConfig, NodeNotFound
from zenostat.topics.messages import (
    Geometry,
    LoopSide,
    ServedZone,
    SurfaceKind,
    SystemComponent,
    SystemLoop,
    SystemNode,
    Systems,
    Task,
)
from zenostat.topics.messages.geometry import ZoneGeometry
from zenostat.views.room.description import describe
from zenostat.views.room.numbers import number, numbers, to_json
from zenostat.views.room.operations import read_operation
from zenostat.views.room.requests import read_body
from zenostat.views.room.schematic import type_words
from zenostat.views.room.series import band_content, band_points, band_zones, simulated_time
from zenostat.views.room.state import zone_states
from zenostat.views.room.storeys import storeys
from zenostat.views.room.updates import Updates
from zenostat.views.room.what_if import WhatIf


def floors(outlines: dict[str, list[tuple[float, float]]], *, unconditioned: tuple[str, ...] = ()) -> Geometry:
    """A building of one storey whose zones have these floors."""
    corners = [(x, y, 0.0) for outline in outlines.values() for x, y in outline]
    return Geometry(
        zones=tuple(
            ZoneGeometry(name=name, storey=0, floor_area_m2=1.0, is_conditioned=name not in unconditioned)
            for name in outlines
        ),
        storeys=(0.0,),
        latitude_deg=0.0,
        longitude_deg=0.0,
        time_zone_h=0.0,
        kinds=bytes([SurfaceKind.FLOOR] * len(outlines)),
        zone_index=np.arange(len(outlines), dtype="<i2").tobytes(),
        exposed=bytes(len(outlines)),
        corner_counts=np.array([len(outline) for outline in outlines.values()], "<u2").tobytes(),
        corners=np.array(corners, "<f4").tobytes(),
    )


AIR, WATER = SystemNode(name="Air out", port="air outlet"), SystemNode(name="Water out", port="water outlet")
RECTANGLE = [(0.0, 0.0), (10.0, 0.0), (10.0, 4.0), (0.0, 4.0)]
ELL = [(0.0, 0.0), (12.0, 0.0), (12.0, 3.0), (3.0, 3.0), (3.0, 12.0), (0.0, 12.0)]


def test_storeys__label_of_a_rectangle_is_in_its_middle() -> None:
    (storey,) = storeys(floors({"ROOM": RECTANGLE}), {"room": 0})
    (zone,) = storey["zones"]
    assert (zone["zone"], zone["outlines"]) == (0, [[list(corner) for corner in RECTANGLE]])
    assert zone["label"] == [5.0, 2.0, 2.0]


@pytest.mark.parametrize("outline", [ELL, ELL[::-1], [(-y, x) for x, y in ELL]])
def test_storeys__label_of_a_concave_zone_is_inside_it(outline: list[tuple[float, float]]) -> None:
    (storey,) = storeys(floors({"ROOM": outline}), {"room": 0})
    x, y, distance = storey["zones"][0]["label"]
    if outline[1] == (0.0, 12.0):
        x, y = y, -x  # as before the rotation
    assert 0 < x < 12
    assert 0 < y < 12
    assert x < 3 or y < 3
    assert 1.0 < distance <= 3 * (2 - math.sqrt(2)) + 0.01  # of the circle in the corner


def test_storeys__plenum_without_a_temperature_is_left_out() -> None:
    building = floors({"ROOM": RECTANGLE, "PLENUM": RECTANGLE, "SHAFT": RECTANGLE}, unconditioned=("PLENUM",))
    (storey,) = storeys(building, {"room": 0})
    assert [(zone["name"], zone["zone"]) for zone in storey["zones"]] == [("ROOM", 0), ("SHAFT", None)]
    assert storeys(building, {}) == []


def test_description__meters_are_shown_as_power_and_points_belong_to_zones() -> None:
    of = manifest(
        sensors=[sensor("room_air_temperature", key="ROOM"), sensor("fan_power", "Fan Electricity Rate", unit="W")],
        meters=[meter("electricity")],
        actuators=[actuator("cooling", 20.0, 30.0)],
    )
    content = describe(of, floors({"ROOM": RECTANGLE})).content
    air, fan, electricity, cooling = content["points"]
    assert (air["zone"], air["unit"]) == (0, "°C")
    assert (fan["unit"], fan["factor"]) == ("kW", 1e-3)
    assert (electricity["unit"], electricity["factor"]) == ("kW", pytest.approx(1.0 / 900_000.0))  # J in 15 min
    assert (cooling["kind"], cooling["low"], cooling["high"]) == ("actuator", 20.0, 30.0)
    assert content["storeys"][0]["zones"][0]["zone"] == 0
    assert describe(of, None).content["storeys"] == []
    to_json(content)


def test_description__id_tells_an_actuator_from_a_sensor_of_its_name() -> None:
    of = manifest(sensors=[sensor("temp"), sensor("valve")], actuators=[actuator("temp"), actuator("pump")])
    points = describe(of, None).content["points"]
    assert [point["id"] for point in points] == ["temp", "valve", "actuator/temp", "pump"]
    assert [point["name"] for point in points] == ["temp", "valve", "temp", "pump"]


def test_description__outdoor_temperature_of_a_district_names_its_plant() -> None:
    names = ("west.outdoor", "east.outdoor")
    of = manifest(sensors=[sensor(name, "Site Outdoor Air Drybulb Temperature") for name in names])
    assert describe(of, None).content["outdoor_label"] == "Outdoors, west"
    of = manifest(sensors=[sensor("outdoor", "Site Outdoor Air Drybulb Temperature")])
    assert describe(of, None).content["outdoor_label"] == "Outdoors"


def test_schematic__values_of_nodes_and_components_stand_at_their_component() -> None:
    building = Systems(
        components=(
            SystemComponent(kind="Coil:Heating:Water", name="Coil", outlets=(WATER, AIR)),
            SystemComponent(kind="AirLoopHVAC:UnitarySystem", name="Unit", outlets=(AIR,), parts=(0, 2)),
            SystemComponent(kind="Fan:OnOff", name="Fan"),
        ),
        loops=(
            SystemLoop(
                kind="AirLoopHVAC",
                name="Air",
                sides=(LoopSide(name="supply", stages=(((1,),),)),),
                zones=(ServedZone(zone="Room", equipment=(0,)), ServedZone(zone="Plenum")),
            ),
        ),
    )
    of = manifest(
        sensors=[
            sensor("a", "System Node Temperature", key="AIR OUT"),
            sensor("b", "System Node Mass Flow Rate", key="WATER OUT", unit="kg/s"),
            sensor("c", "Heating Coil Heating Rate", key="COIL", unit="W"),
            sensor("d", "Fan Electricity Rate", key="FAN", unit="W"),
            sensor("room_air_temperature", key="ROOM"),
        ]
    )
    content = describe(of, None, building).content["systems"]
    coil, unit, fan = content["components"]
    assert coil["values"] == [(1, "Water mass flow"), (2, "Heating")]
    assert unit["values"] == [(0, "Temperature")]  # the unit's outlet, not that of its coil
    assert fan["values"] == [(3, "Electricity")]
    assert [each["type"] for each in content["components"]] == ["Heating coil, water", "Unitary system", "Fan, on off"]
    (loop,) = content["loops"]
    assert loop["sides"] == [{"name": "supply", "stages": [[[1]]]}]
    assert [zone["zone"] for zone in loop["zones"]] == [0, None]
    assert describe(of, None).content["systems"] is None


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("AirTerminal:SingleDuct:VAV:Reheat", "VAV terminal, reheat"),
        ("AirLoopHVAC:OutdoorAirSystem", "Outdoor air system"),
        ("Coil:Cooling:DX:TwoSpeed", "Cooling coil, DX, two speed"),
        ("ZoneHVAC:PackagedTerminalAirConditioner", "Packaged terminal air conditioner"),
        ("Chiller:Electric:ReformulatedEIR", "Chiller, electric, reformulated EIR"),
        ("AirLoopHVAC", "Air loop HVAC"),
    ],
)
def test_type_words__are_those_of_the_field(kind: str, words: str) -> None:
    assert type_words(kind) == words


def test_zone_states__deviation_has_the_sign_and_color_of_its_side() -> None:
    names = ("cold_air_temperature", "good_air_temperature", "warm_air_temperature")
    of = manifest(sensors=[sensor(name, key=name.upper()) for name in names])
    values = dict(zip(names, (18.5, 22.0, 29.0), strict=True))
    states = zone_states(describe(of, None), view(of, **values))
    assert [state["deviation"] for state in states] == [-1.5, 0.0, 3.0]  # against 20 to 26 °C
    red, blue = ([int(state["color"][at : at + 2], 16) for state in states] for at in (1, 5))
    assert red[0] < blue[0]
    assert red[2] > blue[2]


def test_band__limits_are_those_of_the_day_of_each_sample() -> None:
    reward = {"kind": "linear", "winter": [20.0, 23.5], "summer": [23.0, 26.0], "summer_begin": [7, 2]}
    of = manifest(sensors=[sensor("a"), sensor("b")], task=Task(reward=reward))
    description = describe(of, None)
    history = History(of, 0, 0, ("a",), ("degC",), 48, 0, np.array([0, 48, 96, 144]), np.full((4, 1), 24.0))
    zones = band_zones(description, "all")
    assert band_points(description, zones) == {}
    winter, summer = (20.0, 23.5), (23.0, 26.0)  # the timestep that ends at midnight is of 1 July
    low, high = zip(winter, winter, winter, summer, strict=True)
    assert band_content(description, history, zones) == {"low": [*low], "high": [*high]}
    assert band_content(description, history, band_zones(description, None))["low"] == [None] * 4


def test_band__limits_follow_the_setpoints_of_the_zone() -> None:
    setpoints = {"b": ["b_heat", "b_cool"], "c": ["c_heat", "c_cool"]}
    names = ("a", "b", "c", "b_heat", "b_cool", "c_heat", "c_cool")
    variables = dict.fromkeys(names[3:], "Schedule Value")
    sensors = [sensor(name, variables.get(name, "Zone Air Temperature")) for name in names]
    reward = {"kind": "multi_zone", "zones": setpoints, "threshold": 0.5}
    of = manifest(sensors=sensors, task=Task(reward=reward))
    description = describe(of, None)
    zones = band_zones(description, "1")
    assert band_points(description, zones) == {"b_heat": 3, "b_cool": 4}
    values = np.array([[25.0, 15.0, 22.0], [30.0, 20.0, 22.0]])  # in another order than those of a sample
    history = History(of, 0, 0, ("b_cool", "b_heat", "b"), ("degC",) * 3, 1, 0, np.arange(2), values)
    assert band_content(description, history, zones) == {"low": [14.5, 19.5], "high": [25.5, 30.5]}
    both = np.array([[15.0, 25.0, 15.0, 25.0], [20.0, 25.0, 15.0, 25.0]])
    history = History(of, 0, 0, names[3:], ("degC",) * 4, 1, 0, np.arange(2), both)
    assert band_content(description, history, range(1, 3)) == {"low": [14.5, None], "high": [25.5, None]}


@pytest.mark.parametrize("text", ["", "-1", "2", "all zones", "9" * 99, "\u0663"])
def test_band__other_zones_are_refused(text: str) -> None:
    with pytest.raises(InvalidConfig, match="'all' or the number of a zone, 0 to 1, expected"):
        band_zones(describe(manifest(sensors=[sensor("a"), sensor("b")]), None), text)


def test_numbers__are_rounded_and_null_where_there_is_no_value() -> None:
    assert numbers([1.23456789, math.nan, math.inf, -0.5]) == [1.234568, None, None, -0.5]
    assert number(None) is None


@pytest.mark.parametrize("text", ["\n", "\r\n\r\nevent: node\ndata: {}", "\u2028", "</script>", "\x00"])
def test_to_json__text_cannot_end_a_line_of_a_stream(text: str) -> None:
    encoded = to_json({"text": text})
    assert json.loads(encoded) == {"text": text}
    assert encoded.isascii()
    assert not set(encoded) & set(b"\r\n")


def test_what_if__all_setpoints_of_a_large_building_can_be_tried() -> None:
    values = {f"room_{number}_cooling_setpoint": 27.0 for number in range(5000)}
    assert read_body(WhatIf, json.dumps({"values": values}).encode()).values == values


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("write", b'{"point": "a", "value": "26"}'),
        ("write", b'{"point": "a", "value": 26, "priority": 0}'),
        ("write", b'{"point": "a", "value": 26, "source": "Grace"}'),
        ("write", b'{"point": "a", "value": NaN}'),
        ("write", b"[]"),
        ("step", b'{"steps": true}'),
        ("pace", b'{"speed": 0}'),
        ("pause", b"{"),
    ],
)
def test_operations__invalid_request_is_rejected(name: str, body: bytes) -> None:
    with pytest.raises(InvalidConfig):
        read_operation(name, body)


@pytest.mark.parametrize("name", ["stop", "__class__", "wrte"])
def test_operations__others_do_not_exist(name: str) -> None:
    with pytest.raises(NodeNotFound, match="no operation"):
        read_operation(name, b"{}")


def test_simulated_time__utc_stands_for_standard_time() -> None:
    assert simulated_time("2017-07-03T06:00:00.000Z") == "2017-07-03T06:00:00"
    assert simulated_time("2017-07-03T06:00:00+02:00") == "2017-07-03T04:00:00"
    assert simulated_time("2017-07-03T06:00") == "2017-07-03T06:00"
    assert simulated_time("yesterday") == "yesterday"
    assert simulated_time("0001-01-01T00:00:00+14:00") == "0001-01-01T00:00:00"
    assert simulated_time("9999-12-31T23:59:59-01:00") == "9999-12-31T23:59:59"


async def test_updates__slow_page_gets_only_the_latest_of_each_topic(clock: Clock) -> None:
    updates = Updates(clock)
    updates.publish("node:a", b"0")
    updates.start()
    stream = updates.follow(["node:a", "overview"])
    assert await anext(stream) == b"retry: 1000\n\n"
    assert await anext(stream) == b"id: 0.000\nevent: node\ndata: 0\n\n"
    clock.now_s = 1.5
    for count in range(1, 1001):
        updates.publish("node:a", b"%d" % count)
        updates.publish("node:b", b"%d" % count)
    await asyncio.sleep(0)
    updates.publish("overview", b"[]")
    assert await anext(stream) == b"id: 1.500\nevent: node\ndata: 1000\n\n"
    assert await anext(stream) == b"id: 1.500\nevent: overview\ndata: []\n\n"
    assert updates.followers == 1
    updates.close()
    assert [message async for message in stream] == []
    assert updates.followers == 0


async def test_updates__page_gets_an_event_even_if_nothing_changes(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zenostat.views.room.updates._KEEP_ALIVE_S", 0.0)
    updates = Updates(clock)
    updates.start()
    stream = updates.follow(["overview"])
    assert await anext(stream) == b"retry: 1000\n\n"
    assert await anext(stream) == b"id: 0.000\nevent: alive\ndata: {}\n\n"
    clock.now_s = 5.0
    assert await anext(stream) == b"id: 5.000\nevent: alive\ndata: {}\n\n"
    updates.close()
    assert [message async for message in stream] == []
