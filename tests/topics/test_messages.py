"""Message classes: what exists is valid and stays as it is; and a sample as a controller sees it."""

import math
from datetime import timedelta

import numpy as np
import pytest
from pydantic import ValidationError
from support.builders import NAN, actuator, manifest, meter, sensor

from zenostat.bridge.client.sample import SampleView
from zenostat.topics import messages
from zenostat.topics.errors import BadMessage, UnknownName, UsageError
from zenostat.topics.messages import Claim, Command, Event, EventKind, Flag, Manifest, Message, Sample, Sensor, Write
from zenostat.topics.points import value_index

CLASSES = sorted(
    (c for c in vars(messages).values() if isinstance(c, type) and issubclass(c, Message) and c is not Message),
    key=lambda c: c.__name__,
)


@pytest.mark.parametrize("kind", CLASSES, ids=lambda c: c.__name__)
def test_messages__class_is_frozen_closed_finite_and_explained(kind: type[Message]) -> None:
    assert kind.model_config["frozen"]
    assert kind.model_config["extra"] == "forbid"
    assert kind.model_config["allow_inf_nan"] is False
    assert kind.__doc__
    assert kind.__doc__.strip().endswith(".")


def test_messages__message_cannot_be_changed() -> None:
    write = Write(value=21.0)
    with pytest.raises(ValidationError, match="frozen"):
        write.value = 22.0


def test_messages__unknown_field_is_refused() -> None:
    with pytest.raises(ValidationError, match="colour"):
        Write.model_validate({"value": 21.0, "colour": "red"})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_messages__number_that_is_not_finite_is_refused(bad: float) -> None:
    with pytest.raises(ValidationError):
        Write(value=bad)
    with pytest.raises(ValidationError):
        Write(value=1.0, duration_s=bad)
    with pytest.raises(ValidationError):
        actuator("heat", low=bad)


@pytest.mark.parametrize("priority", [1, 8, 16])
def test_messages__bacnet_has_sixteen_levels(priority: int) -> None:
    assert Write(value=1.0, priority=priority).priority == priority
    assert Claim(controller="a", priority=priority).priority == priority


@pytest.mark.parametrize("priority", [0, 17, -1])
def test_messages__there_is_no_other_level(priority: int) -> None:
    with pytest.raises(ValidationError):
        Write(value=1.0, priority=priority)
    with pytest.raises(ValidationError):
        Claim(controller="a", priority=priority)


def test_messages__person_writes_above_a_controller() -> None:
    # BACnet (ASHRAE 135, table 19-1): level 8 is the manual operator's; a lower number rules a higher one.
    assert Write(value=1.0).priority == 8
    assert Claim(controller="a").priority > 8


def test_messages__claim_asks_for_all_and_is_waited_for_unless_it_states_otherwise() -> None:
    claim = Claim(controller="a")
    assert claim.actuators is None
    assert claim.required


@pytest.mark.parametrize("seconds", [0.0, -1.0])
def test_messages__write_lasts_some_time_or_for_good(seconds: float) -> None:
    with pytest.raises(ValidationError):
        Write(value=1.0, duration_s=seconds)
    assert Write(value=1.0).duration_s is None


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b", "@a", "-a", "a\n", "ä", "a" * 129])
def test_messages__what_cannot_stand_in_a_key_is_no_name(name: str) -> None:
    if name:  # a message without its sender has the one in its key
        with pytest.raises(ValidationError):
            Claim(controller=name)
    with pytest.raises(ValidationError):
        sensor(name, key="k")


@pytest.mark.parametrize("field", ["episode", "step"])
def test_messages__steps_and_episodes_are_counted_from_zero(field: str) -> None:
    fields = {"episode": [0], "step": [0], "values": b""}
    Command.model_validate(fields)
    with pytest.raises(ValidationError):
        Command.model_validate(fields | {field: [-1]})


def test_messages__values_of_a_command_stand_last() -> None:
    assert list(Command.model_fields)[-1] == "values"


def test_messages__manifest_names_the_sensors_and_then_the_meters() -> None:
    built = manifest(sensors=[sensor("b"), sensor("a")], meters=[meter("0")], actuators=[actuator("heat")])
    assert built.names == ("b", "a", "0")


@pytest.mark.parametrize("step_s", [0.0, -1.0, float("nan"), float("inf")])
def test_messages__timestep_is_positive_and_finite(step_s: float) -> None:
    fields = manifest().model_dump()
    with pytest.raises(ValidationError):
        Manifest.model_validate(fields | {"step_s": step_s})


def test_messages__timestep_may_have_any_length() -> None:
    built = manifest().model_copy(update={"step_s": 0.5})
    assert built.timestep == timedelta(milliseconds=500)


def test_messages__kinds_and_flags_travel_as_plain_text_and_numbers() -> None:
    assert Event(kind="late", text="").kind is EventKind.LATE
    assert Sensor(name="a", variable="v", key="k", unit="W", aggregation="mean").aggregation == "mean"
    assert int(Flag.FIRST) & int(Flag.TRUNCATED) == 0


# A sample as a controller sees it: two slots, two sensors and a meter, two actuators

BUILDING = manifest(
    sensors=[sensor("zone_t"), sensor("outdoor_t")],
    meters=[meter("electricity")],
    actuators=[actuator("heat"), actuator("cool")],
    slots=2,
)
WIRE = Sample(
    episode=[3, 4],
    step=[0, 96],
    time=["2017-07-01T00:00:00", "2017-07-02T00:00:00"],
    elapsed_s=[0.0, 86400.0],
    flags=[int(Flag.FIRST), int(Flag.TRUNCATED)],
    values=np.array([21.5, -5.0, 0.0, 25.25, 30.0, 9.0e5], "<f8").tobytes(),
    effective=np.array([20.0, NAN, 15.0, 26.0], "<f8").tobytes(),
    source_index=np.array([1, 0, 0, 2], "<u2").tobytes(),
    sources=["", "agent", "wall"],
)


def view(wire: Sample = WIRE, slot: int = 0) -> SampleView:
    return SampleView(wire, BUILDING, value_index(BUILDING), slot=slot)


def test_messages__each_slot_has_its_own_part_of_the_frame() -> None:
    first, second = view(), view(slot=1)
    assert first.as_dict() == {"zone_t": 21.5, "outdoor_t": -5.0, "electricity": 0.0}
    assert second.as_dict() == {"zone_t": 25.25, "outdoor_t": 30.0, "electricity": 9.0e5}
    assert (first.episode, first.step, first.truncated) == (3, 0, False)
    assert (second.episode, second.step, second.truncated) == (4, 96, True)
    assert (second.time - first.time).total_seconds() == 86400.0


def test_sample__has_effective_values_and_their_sources() -> None:
    assert view().effective[0] == 20.0
    assert np.isnan(view().effective[1])
    assert view().value_source == {"heat": "agent", "cool": ""}
    assert view(slot=1).effective.tolist() == [15.0, 26.0]
    assert view(slot=1).value_source == {"heat": "", "cool": "wall"}


def test_messages__value_is_read_by_name_and_an_unknown_name_lists_near_ones() -> None:
    assert view()["outdoor_t"] == -5.0
    with pytest.raises(UnknownName, match="'zone_t'"):
        view()["zone_temp"]


def test_messages__frame_of_another_size_is_a_bad_message() -> None:
    short = WIRE.model_copy(update={"values": WIRE.values[:-8]})
    with pytest.raises(BadMessage, match="40 bytes; 48 expected"):
        view(short)["zone_t"]


def test_messages__listener_cannot_answer() -> None:
    for use in (view().send, lambda: view().weather(["dry_bulb_temperature"])):
        with pytest.raises(UsageError, match="only a controller can") as caught:
            use()
        assert not isinstance(caught.value, UnknownName)
