"""Numbers of things in sentences."""

import pytest

from zenostat.topics.plurals import counted


@pytest.mark.parametrize(
    ("count", "noun", "spec", "text"),
    [
        (0, "sensor", "", "0 sensors"),
        (1, "sensor", "", "1 sensor"),
        (2, "air loop", "", "2 air loops"),
        (1, "entry", "", "1 entry"),
        (3, "entry", "", "3 entries"),
        (35040, "step", ",", "35,040 steps"),
        (35040, "step", "", "35040 steps"),
    ],
)
def test_counted__noun_has_the_number(count: int, noun: str, spec: str, text: str) -> None:
    assert counted(count, noun, spec) == text
