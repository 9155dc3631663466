"""The priority array against the plainest model that can be thought of: a dict of levels for each actuator."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from zenostat.bridge.exchange.priority_array import BASELINE_SOURCE, PRIORITIES, PriorityArray

SLOTS, ACTUATORS = 2, 3
NAMES = [f"controller {i}" for i in range(5)]

priorities = st.integers(1, PRIORITIES)
finite = st.floats(allow_nan=False, allow_infinity=False)
source_names = st.sampled_from(NAMES)
cells = st.lists(finite | st.none(), min_size=SLOTS * ACTUATORS, max_size=SLOTS * ACTUATORS)
chosen = st.lists(st.booleans(), min_size=SLOTS * ACTUATORS, max_size=SLOTS * ACTUATORS)


def resolved(array: PriorityArray) -> list[tuple[float | None, str]]:
    """For each actuator of each slot: the ruling value (None: the building's own) and who set it."""
    values, sources = array.resolve()
    rows = zip(np.frombuffer(values).tolist(), np.frombuffer(sources, "<u2").tolist(), strict=True)
    return [(None if np.isnan(value) else value, array.names[source]) for value, source in rows]


class Model(RuleBasedStateMachine):
    """Any puts and releases: the lowest occupied level rules, an empty array is the building's own."""

    @initialize()
    def begin(self) -> None:
        self.array = PriorityArray(SLOTS, ACTUATORS)
        self.model: list[dict[int, tuple[float, str]]] = [{} for _ in range(SLOTS * ACTUATORS)]

    def _set(self, cell: int, priority: int, name: str, value: float | None) -> None:
        if value is None:
            self.model[cell].pop(priority, None)
        else:
            self.model[cell][priority] = (value, name)

    @rule(
        priority=priorities,
        name=source_names,
        values=st.lists(finite, min_size=SLOTS * ACTUATORS, max_size=SLOTS * ACTUATORS),
    )
    def put_all(self, priority: int, name: str, values: list[float]) -> None:
        self.array.put_all(priority, self.array.source(name), np.array(values).tobytes())
        for cell, value in enumerate(values):
            self._set(cell, priority, name, value)

    @rule(priority=priorities, name=source_names, values=cells, where=chosen)
    def put(self, priority: int, name: str, values: list[float | None], where: list[bool]) -> None:
        shape = (SLOTS, ACTUATORS)
        numbers = np.array([np.nan if v is None else v for v in values]).reshape(shape)
        self.array.put(priority, self.array.source(name), numbers, np.array(where).reshape(shape))
        for cell, (value, meant) in enumerate(zip(values, where, strict=True)):
            if meant:
                self._set(cell, priority, name, value)

    @rule(priority=priorities, name=source_names, actuator=st.integers(0, ACTUATORS - 1), value=finite | st.none())
    def put_one(self, priority: int, name: str, actuator: int, value: float | None) -> None:
        self.array.put_one(priority, self.array.source(name), actuator, np.nan if value is None else value)
        for slot in range(SLOTS):
            self._set(slot * ACTUATORS + actuator, priority, name, value)

    @rule()
    def clear(self) -> None:
        self.array.clear()
        self.model = [{} for _ in self.model]

    @invariant()
    def the_table_has_each_value_at_its_priority(self) -> None:
        if hasattr(self, "array"):
            values, sources = self.array.table()
            assert values.shape == sources.shape == (SLOTS, ACTUATORS, PRIORITIES)
            for cell, entries in enumerate(self.model):
                row, by = values.reshape(-1, PRIORITIES)[cell], sources.reshape(-1, PRIORITIES)[cell]
                shown = {p + 1: (row[p], self.array.names[by[p]]) for p in range(PRIORITIES) if not np.isnan(row[p])}
                assert shown == entries

    @invariant()
    def the_lowest_occupied_level_rules(self) -> None:
        if hasattr(self, "array"):
            expected = [cell[min(cell)] if cell else (None, BASELINE_SOURCE) for cell in self.model]
            assert resolved(self.array) == expected


TestAgainstTheModel = Model.TestCase
TestAgainstTheModel.settings = settings(deadline=None)


def test_priority_array__lower_rules_release_falls_to_the_next_and_empty_is_the_building() -> None:
    # fire@1 over person@8 over controller@10
    array = PriorityArray(1, 1)
    for priority, name, value in ((10, "controller", 24.0), (8, "person", 22.0), (1, "fire", 15.0)):
        array.put_one(priority, array.source(name), 0, value)
    assert resolved(array) == [(15.0, "fire")]
    for priority, next_ruler in ((1, (22.0, "person")), (8, (24.0, "controller")), (10, (None, BASELINE_SOURCE))):
        array.put_one(priority, array.source("anybody"), 0, np.nan)
        assert resolved(array) == [next_ruler]


@given(finite)
def test_priority_array__value_rules_to_the_last_bit(value: float) -> None:
    array = PriorityArray(1, 2)
    raw = np.array([value, -0.0]).tobytes()
    array.put_all(10, array.source("a"), raw)
    assert array.resolve()[0] == raw
    array.put_one(16, array.source("b"), 0, 1.0)
    assert array.resolve()[0] == raw


def test_priority_array__another_source_at_the_same_level_is_named() -> None:
    array = PriorityArray(1, 2)
    array.put_all(10, array.source("a"), np.array([1.0, 2.0]).tobytes())
    array.put_all(10, array.source("b"), np.array([3.0, 4.0]).tobytes())
    assert resolved(array) == [(3.0, "b"), (4.0, "b")]


def test_priority_array__name_has_one_index_and_the_building_has_the_first() -> None:
    array = PriorityArray(1, 1)
    assert array.source(BASELINE_SOURCE) == 0
    assert array.source("a") == array.source("a") == 1
    assert array.source("b") == 2
    assert array.names == [BASELINE_SOURCE, "a", "b"]


def test_priority_array__flood_of_names_that_hold_nothing_stays_small() -> None:
    array = PriorityArray(1, 1)
    indices = [array.source(f"device {i}") for i in range(1000)]
    assert indices[:255] == list(range(1, 256))
    assert max(indices) == 255
    assert len(array.names) == 256
    assert array.names[indices[-1]] == "device 999"  # in the place of one that set nothing
    array.put_all(10, indices[-1], np.array([1.0]).tobytes())
    assert len(array.resolve()[1]) == 2


@pytest.mark.parametrize(("slots", "actuators"), [(1, 0), (3, 0), (3, 2)])
def test_priority_array__array_that_nobody_set_is_the_buildings(slots: int, actuators: int) -> None:
    assert resolved(PriorityArray(slots, actuators)) == [(None, BASELINE_SOURCE)] * (slots * actuators)
