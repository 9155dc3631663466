"""Options of the form NAME=VALUE."""

from typing import Any

import pytest

from zenostat.cli.pairs import read_pairs, read_parameters, read_rates
from zenostat.topics.errors import InvalidConfig

VALUES = {
    "true": True,
    "False": False,
    "null": None,
    "None": None,
    "3": 3,
    "-0.5": -0.5,
    "1e-3": 1e-3,
    "zone": "zone",
    "on": "on",
    "'01'": "01",
    "tcp/127.0.0.1:7447": "tcp/127.0.0.1:7447",
    "a=b": "a=b",
    "[1, 2]": [1, 2],
    "['tank.der(T)']": ["tank.der(T)"],
    "{low: 1}": {"low": 1},
}


@pytest.mark.parametrize(("text", "value"), VALUES.items())
def test_read_parameters__values_are_those_of_yaml(text: str, value: Any) -> None:
    (read,) = read_parameters([f"x={text}"]).values()
    assert (read, type(read)) == (value, type(value))


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["margin"], "--set margin: expected a name and a value, for example --set margin=0.5"),
        (["=1"], "--set =1: expected a name and a value"),
        (["a=1", "b=2", "a=3"], "--set a occurs twice: 1 and 3"),
        (["a=[1"], r"--set a=\[1: .* is not valid YAML"),
    ],
)
def test_read_parameters__mistakes_are_named(texts: list[str], message: str) -> None:
    with pytest.raises(InvalidConfig, match=message):
        read_parameters(texts)


def test_read_pairs__no_option_is_none() -> None:
    assert read_pairs("--low", None, "an actuator and a number", "fan=1") == {}


def test_read_pairs__name_with_an_equals_sign() -> None:
    assert read_pairs("--set", ["'a=b'.T=1.5"], "a variable and a value", "T=1", split=str.rpartition) == {
        "'a=b'.T": 1.5
    }


def test_read_pairs__numbers() -> None:
    assert read_pairs("--low", ["fan=1", "pump=2e1"], "an actuator and a number", "fan=1", read=float) == {
        "fan": 1.0,
        "pump": 20.0,
    }
    with pytest.raises(InvalidConfig, match="--low fan=x: expected an actuator and a number, for example --low fan=1"):
        read_pairs("--low", ["fan=x"], "an actuator and a number", "fan=1", read=float)


def test_read_rates__are_numbers_or_files() -> None:
    assert read_rates("--price", ["electricity=1", "gas=gas.csv"]) == {"electricity": 1.0, "gas": "gas.csv"}
    for text in ("gas", "gas=", "=1"):
        with pytest.raises(InvalidConfig, match=f"--price {text}: expected a fuel and a number or file"):
            read_rates("--price", [text])
