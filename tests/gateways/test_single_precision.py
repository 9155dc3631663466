"""Numbers in single precision and the bounds that they are compared with."""

import math
import struct

from hypothesis import example, given
from hypothesis import strategies as st

from zenostat.gateways.single_precision import intended, single, snapped
from zenostat.topics.messages import Actuator

FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e30, max_value=1e30)


@given(FINITE)
@example(29.444444444444443)
def test_single_precision__rounded_bound_is_the_bound(bound: float) -> None:
    assert snapped(Actuator(name="a", unit="1", high=bound), single(bound)) == bound
    assert snapped(Actuator(name="a", unit="1", low=bound), single(bound)) == bound


@given(FINITE, FINITE)
def test_single_precision__other_numbers_are_themselves(bound: float, value: float) -> None:
    if single(bound) != single(value):
        assert snapped(Actuator(name="a", unit="1", low=bound, high=bound + 1e31), single(value)) == single(value)


@given(st.floats(width=32, allow_nan=False))
def test_single_precision__single_keeps_what_it_can_hold(value: float) -> None:
    assert struct.pack(">d", single(value)) == struct.pack(">d", value)


def test_single_precision__infinity_is_no_bound_that_is_beyond_the_range() -> None:
    assert single(1e300) == math.inf
    assert snapped(Actuator(name="a", unit="1", high=1e300), math.inf) == math.inf


def test_single_precision__decimal_that_a_client_has_rounded_is_intended() -> None:
    limits = Actuator(name="a", unit="1", low=-17.8, high=1e6)
    for number in (-17.8, 0.6, 21.1, 1e5):
        assert intended(limits, single(number)) == number
