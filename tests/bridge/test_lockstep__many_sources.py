"""More sources than a byte can count: each is told by its own name, and too many are refused."""

import numpy as np
import pytest
from support.builders import actuator, advance, claim, command, exchange, ruling

from zenostat.bridge.exchange.claims import MAX_CLAIMS
from zenostat.bridge.exchange.priority_array import MAX_SOURCES
from zenostat.topics.errors import RequestRejected
from zenostat.topics.messages import CommandOp, EventKind, Write

IDLE = 300


def test_write__is_reported_with_its_source_beside_300_claims() -> None:
    at = exchange(*(actuator(f"a{i}", 0.0, 100.0) for i in range(IDLE)))
    for number in range(IDLE):
        claim(at, f"idle{number}", actuators=[f"a{number}"], required=False)
    assert at.intake.write("a1", Write(value=7.0, source="panel"), 0.0).kind is EventKind.WRITTEN
    assert ruling(at)[1][:3] == ["", "panel", ""]


def test_sample__names_each_of_300_controllers() -> None:
    at = exchange(*(actuator(f"a{i}", 0.0, 1000.0) for i in range(IDLE)))
    for number in range(IDLE):
        claim(at, f"c{number}", 10, actuators=[f"a{number}"])
    for number in range(IDLE):
        mask = [CommandOp.SET if i == number else CommandOp.KEEP for i in range(IDLE)]
        assert at.intake.command(f"c{number}", command(np.full(IDLE, float(number)), operations=mask), 0.0) is None
    assert at.intake.write("a7", Write(value=70.0, source="panel"), 0.0).kind is EventKind.WRITTEN
    values, sources = advance(at)
    expected = [f"c{number}" for number in range(IDLE)]
    expected[7] = "panel"
    assert sources == expected
    assert values == [70.0 if number == 7 else float(number) for number in range(IDLE)]


@pytest.mark.slow
def test_lockstep__too_many_claims_are_refused_until_some_have_gone() -> None:
    at = exchange(*(actuator(f"a{i}", 0.0, 1.0) for i in range(MAX_CLAIMS + 1)))
    for number in range(MAX_CLAIMS):
        claim(at, f"c{number}", actuators=[f"a{number}"])
    with pytest.raises(RequestRejected, match=rf"^{MAX_CLAIMS} controllers have a claim, which is the maximum"):
        claim(at, "another", actuators=[f"a{MAX_CLAIMS}"])
    assert "another" not in at.claims.by_name
    claim(at, "c5", actuators=["a5"])  # again
    at.fallback.on_disconnect("c6", 0.0)
    at.reset()
    claim(at, "another", actuators=[f"a{MAX_CLAIMS}"])


def test_lockstep__too_many_sources_are_refused_by_name_and_releasing_makes_place() -> None:
    at = exchange(*(actuator(f"a{i}", 0.0, 1.0) for i in range(MAX_SOURCES)))
    for number in range(1, MAX_SOURCES):
        assert at.intake.write(f"a{number}", Write(value=1.0, source=f"w{number}"), 0.0).kind is EventKind.WRITTEN
    over = at.intake.write("a0", Write(value=1.0, source="panel"), 0.0)
    assert (over.kind, over.source) == (EventKind.REJECTED, "panel")
    assert f"{MAX_SOURCES} sources command actuators, which is the maximum" in over.text
    assert at.intake.write("a0", Write(value=0.5, source="w9"), 0.0).kind is EventKind.WRITTEN
    assert at.intake.write("a3", Write(value=None, source="panel"), 0.0).kind is EventKind.WRITTEN
    assert at.intake.write("a3", Write(value=0.5, source="panel"), 0.0).kind is EventKind.WRITTEN
    _, sources = ruling(at)
    assert sources[3] == "panel"
    assert sources[9] == "w9" == sources[0]
