"""YAML files of users: what is wrong with one is said in one line, with its place."""

import pytest

from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1\n", "f.yaml is not valid YAML: line 2, column 1: did not find expected ',' or ']' while parsing"),
        ("a: 1\na: 2", "f.yaml is not valid YAML: line 2, column 1: repeated name 'a'"),
        ("\0\1", "f.yaml is not valid YAML: position 0: unacceptable character #x0000"),
        ("", "f.yaml: names with values expected, each as `name: value`; it is empty"),
        ("[1, 2]", "f.yaml: names with values expected, each as `name: value`; got a list"),
        ("text", "f.yaml: names with values expected, each as `name: value`; got a single value"),
        ("1: 2", "f.yaml: names with values expected, each as `name: value`; got a name that is not a text"),
    ],
)
def test_parse__error_is_one_line_with_the_place(text: str, message: str) -> None:
    with pytest.raises(InvalidConfig) as error:
        yaml12.parse(text, "f.yaml")
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)
