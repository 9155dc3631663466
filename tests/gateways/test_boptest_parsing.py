"""Bodies and values of BOPTEST requests."""

import json
import math
from contextlib import suppress
from urllib.parse import urlencode

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.gateways.boptest import parsing
from zenostat.gateways.boptest.parsing import BadRequest

JSON = "application/json"
FORM = "application/x-www-form-urlencoded"


def test_boptest_parsing__bodies_of_all_forms():
    assert parsing.parse_body(b"", JSON) == {}
    assert parsing.parse_body(b'{"step": 900}', JSON) == {"step": 900}
    assert parsing.parse_body(b'{"step": 900}', "text/plain") == {"step": 900}
    assert parsing.parse_body(b"step=900&name=a&name=b", FORM) == {"step": "900", "name": ["a", "b"]}
    infinite = parsing.parse_body(b'{"a": -Infinity, "b":Infinity, "c": +Infinity}', JSON)
    assert infinite == {"a": -math.inf, "b": math.inf, "c": math.inf}
    assert parsing.parse_body(b'{"a": "+Infinity, 1+1"}', JSON) == {"a": "+Infinity, 1+1"}


@pytest.mark.parametrize(
    "body", [b"[1]", b"{", b"\xff", b'"a"', b"[" * 100_000, b'{"a": "\\ud800"}', b"x" * (parsing.MAX_BYTES + 1)]
)
def test_boptest_parsing__other_bodies_are_refused(body):
    with pytest.raises(BadRequest):
        parsing.parse_body(body, JSON)


@given(st.binary(max_size=200), st.sampled_from([JSON, FORM, "", "multipart/form-data"]))
def test_boptest_parsing__any_bytes_are_fields_or_a_bad_request(body, content_type):
    with suppress(BadRequest):
        assert isinstance(parsing.parse_body(body, content_type), dict)


@given(st.dictionaries(st.text(), st.text() | st.lists(st.text(), min_size=2)))
def test_boptest_parsing__fields_are_the_same_from_json_and_from_a_form(fields):
    assert parsing.parse_body(json.dumps(fields).encode(), JSON) == fields
    assert parsing.parse_body(urlencode(fields, doseq=True).encode(), FORM) == fields


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(), st.lists, max_leaves=5))
def test_boptest_parsing__any_value_is_a_number_and_a_switch_or_a_bad_request(value):
    for read, kind in ((parsing.number, float), (parsing.switch, bool), (parsing.names, list)):
        try:
            result = read(value, "x")
        except BadRequest:
            continue
        assert type(result) is kind
        assert result == result  # no NaN


@pytest.mark.parametrize("value", [math.nan, "nan", True, None, "", "1,5", [1], {}, 10**400])
def test_boptest_parsing__other_values_are_no_numbers(value):
    with pytest.raises(BadRequest, match="for x"):
        parsing.number(value, "x")


@pytest.mark.parametrize("value", [1, True, 1.0, "1", "1.0", "1.", "True", "true"])
def test_boptest_parsing__switches_that_are_on(value):
    assert parsing.switch(value, "x") is True
    assert parsing.switch(json.loads("0"), "x") is False
    assert parsing.switch("0.0", "x") is False


@pytest.mark.parametrize("value", [1.2, "1.2", "invalid", "nan", 2, None, [1]])
def test_boptest_parsing__switches_that_are_neither(value):
    with pytest.raises(BadRequest, match="for x"):
        parsing.switch(value, "x")
