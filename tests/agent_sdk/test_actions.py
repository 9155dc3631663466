"""From an action to a value for each actuator."""

from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from hypothesis import given
from hypothesis import strategies as st
from support.builders import actuator, manifest, own_action

from zenostat.agent_sdk.envs.action_values import Actions
from zenostat.topics.errors import InvalidAction
from zenostat.topics.messages import Action, Actuator, CommandOp, DiscreteAction, Task

HEAT_A, COOL_A = actuator("heat_a", 15.0, 22.5), actuator("cool_a", 22.5, 30.0)
HEAT_B, COOL_B = actuator("heat_b", 15.0, 22.5), actuator("cool_b", 22.5, 30.0)
FOUR = (HEAT_A, COOL_A, HEAT_B, COOL_B)
HEAT = Action(name="heat", unit="degC", low=15.0, high=22.5, actuators=("heat_a", "heat_b"))
COOL = Action(name="cool", unit="degC", low=22.5, high=30.0, actuators=("cool_a", "cool_b"))


def actions(actuators: tuple[Actuator, ...], *of: Action, choices: tuple[DiscreteAction, ...] = ()) -> Actions:
    return Actions(manifest(actuators=actuators, task=Task(actions=of, discrete_actions=choices)))


def one(low: float | None, high: float | None) -> Actions:
    """A single actuator with an action of its own."""
    return Actions(manifest(actuators=[actuator("a", low, high)]))


PAIRS = DiscreteAction(actions=("heat", "cool"), values=((15.0, 30.0), (18.0, 26.0), (22.5, 22.5)))
PICKED = actions(FOUR, HEAT, COOL, choices=(PAIRS,))
BOTH = actions(
    FOUR,
    HEAT,
    COOL,
    choices=(
        DiscreteAction(actions=("cool",), values=((30.0,), (24.0,))),
        DiscreteAction(actions=("heat",), values=((15.0,), (17.0,), (20.0,))),
    ),
)


# Which actuator gets what


def test_actions__each_actuator_has_an_action_of_its_own_where_nothing_is_joined() -> None:
    own = Actions(manifest(actuators=FOUR))
    assert own.values([16.0, 23.0, 17.0, 24.0]).tolist() == [16.0, 23.0, 17.0, 24.0]
    assert own.names == ["heat_a", "cool_a", "heat_b", "cool_b"]
    assert own.operations is None


def test_actions__all_actuators_of_an_action_get_its_value() -> None:
    assert actions(FOUR, HEAT, COOL).values([16.0, 25.0]).tolist() == [16.0, 25.0, 16.0, 25.0]
    assert actions(FOUR, COOL, HEAT).values([25.0, 16.0]).tolist() == [16.0, 25.0, 16.0, 25.0]


def test_actions__order_of_the_actions_need_not_be_that_of_the_actuators() -> None:
    turned = actions((HEAT_A, COOL_A), own_action(COOL_A), own_action(HEAT_A))
    assert turned.values([25.0, 16.0]).tolist() == [16.0, 25.0]


@given(st.data())
def test_actions__whatever_is_joined_each_actuator_gets_its_actions_value(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 6))
    owner = data.draw(st.lists(st.integers(-1, 3), min_size=count, max_size=count))
    points = tuple(actuator(f"p{i}", 0.0, 1.0) for i in range(count))
    groups = {g: tuple(p.name for p, o in zip(points, owner, strict=True) if o == g) for g in set(owner) - {-1}}
    order = data.draw(st.permutations(sorted(groups)))
    joined = actions(points, *(Action(name=f"g{g}", unit="1", low=0.0, high=1.0, actuators=groups[g]) for g in order))
    chosen = [data.draw(st.floats(0.0, 1.0)) for _ in order]
    by_group = dict(zip(order, chosen, strict=True))
    values = joined.values(chosen)
    assert values.dtype == np.float64
    assert values.shape == (count,)
    set_here = [i for i in range(count) if owner[i] != -1]
    assert [values[i] for i in set_here] == [by_group[owner[i]] for i in set_here]
    if len(set_here) == count:
        assert joined.operations is None
    else:
        assert list(joined.operations or b"") == [CommandOp.KEEP if o == -1 else CommandOp.SET for o in owner]


# Actuators that no action sets


def test_actions__what_no_action_sets_is_kept() -> None:
    some = actions(FOUR, COOL)
    assert list(some.operations or b"") == [CommandOp.KEEP, CommandOp.SET, CommandOp.KEEP, CommandOp.SET]
    values = some.values([25.0])
    assert values.shape == (4,)
    assert np.isfinite(values).all()
    assert values[[1, 3]].tolist() == [25.0, 25.0]


def test_actions__without_actions_all_is_kept() -> None:
    none = actions(FOUR)
    assert (none.space.shape, list(none.operations or b"")) == ((0,), [CommandOp.KEEP] * 4)
    assert none.values([]).shape == (4,)


def test_actions__without_actuators_there_is_nothing_to_say() -> None:
    none = actions(())
    assert none.operations is None
    assert none.values(np.zeros(0, np.float32)).shape == (0,)
    with pytest.raises(InvalidAction, match="baseline control only"):
        none.values([1.0])


def test_actions__what_no_action_sets_may_be_set_beside_them() -> None:
    some = actions((*FOUR, actuator("free")), COOL)
    assert some.context({"heat_b": 20.0, "heat_a": None, "free": -1e9}) == {2: 20.0, 0: None, 4: -1e9}
    assert some.context({"heat_a": 15.0, "heat_b": 22.5}) == {0: 15.0, 2: 22.5}, "the ends belong to the bounds"
    assert some.context({}) == {}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"cool_a": 25.0}, "'cool_a' is not an actuator outside the actions"),
        ({"heet_a": 20.0}, "'heet_a'.*'heat_a'"),
        ({"cool": 25.0}, "'cool'"),
        ({"heat_a": 14.9}, r"heat_a = 14\.9; its bounds are 15 to 22\.5 degC"),
        ({"heat_a": 20.0, "heat_b": 22.6}, r"heat_b = 22\.6"),
        ({"free": np.nan}, "free = nan"),
        ({"free": np.inf}, "free = inf"),
        ({"free": "warm"}, "free"),
    ],
)
def test_actions__what_cannot_be_set_beside_the_actions_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidAction, match=words):
        actions((*FOUR, actuator("free")), COOL).context(values)


# Numbers


def test_actions__space_is_that_of_the_actions() -> None:
    space = actions((*FOUR, actuator("free")), HEAT, COOL, own_action(actuator("free"))).space
    assert isinstance(space, Box)
    assert space.dtype == np.float32
    assert space.low.tolist() == [15.0, 22.5, -np.inf]
    assert space.high.tolist() == [22.5, 30.0, np.inf]


@pytest.mark.parametrize("wrong", [[], [20.0], [20.0, 25.0, 25.0], [[20.0, 25.0]], 20.0], ids=str)
def test_actions__another_shape_is_refused_with_the_names_of_the_actions(wrong: Any) -> None:
    with pytest.raises(InvalidAction, match=r"\(2,\) expected: heat, cool"):
        actions(FOUR, HEAT, COOL).values(wrong)


@pytest.mark.parametrize("wrong", ["warm", ["warm", "cold"], [[20.0], [20.0, 25.0]], {"heat": 20.0}, None], ids=str)
def test_actions__what_is_no_array_of_numbers_is_an_invalid_action(wrong: Any) -> None:
    with pytest.raises(InvalidAction):
        actions(FOUR, HEAT, COOL).values(wrong)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_actions__value_that_is_not_finite_is_refused_also_without_bounds(wrong: float) -> None:
    with pytest.raises(InvalidAction, match="a = "):
        one(None, None).values([wrong])
    with pytest.raises(InvalidAction, match="a = "):
        one(15.0, 22.5).values([wrong])


def test_actions__all_values_out_of_bounds_are_named() -> None:
    with pytest.raises(InvalidAction, match=r"heat = 14\b.*15 to 22\.5 degC.*cool = 31\b.*22\.5 to 30 degC"):
        actions(FOUR, HEAT, COOL).values([14.0, 31.0])
    with pytest.raises(InvalidAction) as raised:
        actions(FOUR, HEAT, COOL).values([14.0, 25.0])
    assert "cool" not in str(raised.value)


def test_actions__action_with_one_bound_has_no_other() -> None:
    assert one(0.0, None).values([1e30]).tolist() == [1e30]
    assert one(None, 0.0).values([-1e30]).tolist() == [-1e30]
    with pytest.raises(InvalidAction):
        one(0.0, None).values([-1e-3])
    with pytest.raises(InvalidAction):
        one(None, 0.0).values([1e-3])


bounds = st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)).map(sorted).filter(lambda b: b[1] - b[0] > 1.0)


@given(bounds)
def test_actions__ends_of_the_space_are_allowed_and_never_leave_the_actuators_bounds(ends: list[float]) -> None:
    """A bound such as 0.1 is no float32: the space's lies a rounding error beside it."""
    low, high = ends
    action = one(low, high)
    assert isinstance(action.space, Box)
    for end, bound in ((action.space.low, low), (action.space.high, high)):
        (value,) = action.values(end)
        assert low <= value <= high
        assert value == pytest.approx(bound, rel=1e-6)


@given(bounds)
def test_actions__actuators_own_bounds_are_allowed(ends: list[float]) -> None:
    low, high = ends
    assert one(low, high).values([low]).tolist() == [low]
    assert one(low, high).values([high]).tolist() == [high]


@given(bounds, st.floats(0.0, 1.0))
def test_actions__value_within_goes_through_to_the_bit(ends: list[float], share: float) -> None:
    low, high = ends
    value = low + 0.1 + share * (high - low - 0.2)
    assert one(low, high).values([value]).tolist() == [value]


@given(bounds, st.floats(1e-3, 1e6), st.booleans())
def test_actions__value_outside_is_refused(ends: list[float], beyond: float, above: bool) -> None:
    low, high = ends
    further = max(beyond, 1e-6 * max(abs(low), abs(high)))  # more than float32 rounds
    with pytest.raises(InvalidAction):
        one(low, high).values([high + further if above else low - further])


@given(st.integers(0, 2**32))
def test_actions__every_sample_of_the_space_is_an_action(seed: int) -> None:
    for definition in (actions(FOUR, HEAT, COOL), one(0.1, 0.7), one(None, None), PICKED, BOTH):
        definition.space.seed(seed)
        assert np.isfinite(definition.values(definition.space.sample())).all()


def test_actions__callers_array_is_left_alone() -> None:
    mine = np.array([16.0, 25.0, 16.0, 25.0])
    values = Actions(manifest(actuators=FOUR)).values(mine)
    assert not np.shares_memory(values, mine)


# Choices


def test_actions__one_dimension_is_discrete_and_several_are_multidiscrete() -> None:
    assert PICKED.space == Discrete(3)
    assert BOTH.space == MultiDiscrete([2, 3])


@pytest.mark.parametrize(
    "form", [int, np.int64, np.int32, np.uint8, np.array, lambda i: np.array([i])], ids=lambda f: f.__name__
)
def test_actions__choice_is_a_row_of_values_whatever_integer_names_it(form: Any) -> None:
    assert [PICKED.values(form(i)).tolist() for i in range(3)] == [
        [15.0, 30.0, 15.0, 30.0],
        [18.0, 26.0, 18.0, 26.0],
        [22.5, 22.5, 22.5, 22.5],
    ]


@pytest.mark.parametrize("form", [list, tuple, np.array, lambda v: np.array(v, np.int8), lambda v: np.array(v, "u8")])
def test_actions__choices_of_several_dimensions_each_set_their_own_actions(form: Any) -> None:
    assert BOTH.values(form([1, 2])).tolist() == [20.0, 24.0, 20.0, 24.0]
    assert BOTH.values(form([0, 1])).tolist() == [17.0, 30.0, 17.0, 30.0]


def test_actions__row_names_its_values_in_the_choices_own_order() -> None:
    turned = DiscreteAction(actions=("cool", "heat"), values=((30.0, 15.0), (26.0, 18.0)))
    assert actions(FOUR, HEAT, COOL, choices=(turned,)).values(1).tolist() == [18.0, 26.0, 18.0, 26.0]


@pytest.mark.parametrize(
    "wrong",
    [
        *(-1, 3, 255, 10**30),
        *(1.0, np.float32(1), np.array([1.0]), True, np.bool_(True), "1", None, [], [0, 1], [[1]], [[0], [0, 1]], {}),
    ],
    ids=repr,
)
def test_actions__there_is_no_other_choice(wrong: Any) -> None:
    """True is no 1, as on the bus; 1.0 is none either, for Gymnasium's space does not contain it."""
    with pytest.raises(InvalidAction):
        PICKED.values(wrong)


def test_actions__dimension_without_that_choice_is_named() -> None:
    with pytest.raises(InvalidAction, match="choice 3 of heat, cool; 0 to 2 expected"):
        PICKED.values(3)
    with pytest.raises(InvalidAction, match="choice 2 of cool; 0 to 1 expected"):
        BOTH.values([2, 2])
    with pytest.raises(InvalidAction, match="choice -1 of heat; 0 to 2 expected"):
        BOTH.values([0, -1])


@pytest.mark.parametrize(
    "wrong",
    [[1], [1, 1, 1], [[1, 1]], 1, [1.0, 1.0], [True, False], np.array([1, 1], bool), [1, None], [[1], [1, 1]]],
    ids=repr,
)
def test_actions__several_dimensions_take_an_integer_each(wrong: Any) -> None:
    with pytest.raises(InvalidAction):
        BOTH.values(wrong)


def test_actions__choices_leave_alone_what_no_action_sets() -> None:
    some = actions(FOUR, COOL, choices=(DiscreteAction(actions=("cool",), values=((30.0,), (24.0,))),))
    assert some.values(1)[[1, 3]].tolist() == [24.0, 24.0]
    assert list(some.operations or b"") == [CommandOp.KEEP, CommandOp.SET, CommandOp.KEEP, CommandOp.SET]


def test_actions__action_rescaled_in_float32_means_the_bound() -> None:
    """Gymnasium's RescaleAction computes it so: -1 becomes 14.999999 where the bound is 15."""
    own = Actions(manifest(actuators=[actuator("a", 15.0, 22.5), actuator("b", 22.5, 30.0)]))
    beside = np.nextafter(own.space.low, np.float32(-np.inf)), np.nextafter(own.space.high, np.float32(np.inf))
    assert own.values(beside[0]).tolist() == [15.0, 22.5]
    assert own.values(beside[1]).tolist() == [22.5, 30.0]
    with pytest.raises(InvalidAction, match=r"a = 14\.999"):
        own.values(np.array([14.999, 25.0]))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (np.array([20.0 + 3j, 25.0 + 0j]), "is complex; real numbers expected"),
        (np.array([20.0 + 3j, 25.0], np.complex64), "is complex; real numbers expected"),
        ([np.complex128(20.0), 25.0], "is complex; real numbers expected"),
        (np.ma.masked_all(2), "has masked values; a number for each expected"),
        (np.ma.array([20.0, 25.0], mask=[False, True]), "has masked values; a number for each expected"),
    ],
    ids=repr,
)
def test_actions__complex_and_masked_actions_are_refused(wrong: Any, message: str) -> None:
    own = Actions(manifest(actuators=[actuator("a", 15.0, 22.5), actuator("b", 22.5, 30.0)]))
    for call in (lambda: own.values(wrong), lambda: own.rows(np.ma.stack([wrong, wrong]), 2)):
        with pytest.raises(InvalidAction, match=message):
            call()
    assert own.values(np.ma.array([20.0, 25.0])).tolist() == [20.0, 25.0]


def test_actions__masked_choice_is_refused() -> None:
    with pytest.raises(InvalidAction, match="has masked values"):
        BOTH.values(np.ma.array([0, 1], mask=[True, True]))
