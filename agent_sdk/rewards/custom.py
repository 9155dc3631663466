"""Custom rewards: a function, or a class of a few lines."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from zenostat.agent_sdk.rewards.base import Begin, BoundReward, Outcome, Reward, Terms
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.messages import Manifest

RewardFunction = Callable[[Mapping[str, Any], Any], Mapping[str, Any] | float]
"""A function of `(values, begin)`: the values by the names of sensors and meters, and the time at which the timestep
began. It returns the reward or its terms by name."""

ATTRIBUTES = "attributes"
"""Key of the attributes of a custom reward, in the state of one that has no `state()` and `restore(state)`."""


RewardClass = type | partial[Any]
"""A class whose objects are such functions, or a `functools.partial` of one with its arguments."""


def from_function(function: RewardFunction | RewardClass) -> Reward:
    """Return a reward that calls a function.

    Args:
        function: called once per timestep, and once at the first sample to get the names of its terms, with the values
            by name (floats, or arrays of the leading shape if there are several slots) and the time at which the
            timestep began. It returns the reward, or terms by name that add up to the reward. A callable object may
            also have `reset(slots)`, `state()` and `restore(state)`, see `BoundReward`; without the last two, its
            attributes are its state, and are copied. A class is instantiated for each environment: without arguments,
            or with those of a `functools.partial` of the class.

    Raises:
        InvalidConfig: the function does not take two arguments, or its `reset` not one; at a step, it returned
            something other than a reward.
        UnknownName: at a step, it read a point that the node does not have. Its other exceptions are passed on, with a
            note that names the reward.
    """
    error = _signature_error(function)
    if error is not None:
        raise InvalidConfig(f"reward: {_name(function)} should take (values, begin): {error}")
    kind = class_of(function)
    reset = getattr(function if kind is None else kind, "reset", None)
    if callable(reset) and (error := _call_error(reset, 1 if kind is None else 2)) is not None:
        raise InvalidConfig(f"reward: {_name(function)}.reset should take (slots): {error}")
    return _FunctionReward(function)


def class_of(function: Any) -> type | None:
    """Return the class of a `RewardClass`; None for anything else."""
    kind = function.func if isinstance(function, partial) else function
    return kind if isinstance(kind, type) else None


def _signature_error(function: RewardFunction | RewardClass) -> str | None:
    """Return why it cannot be called with values and a time; None if it can, or has no signature."""
    kind = class_of(function)
    if kind is not None and not any("__call__" in vars(base) for base in kind.__mro__):
        return "it has no __call__"
    return _call_error(function, 2) if kind is None else _call_error(kind.__call__, 3)


def _call_error(called: Any, arguments: int) -> str | None:
    """Return why it cannot be called with a number of arguments; None if it can, or has no signature."""
    try:
        inspect.signature(called).bind(*[None] * arguments)
    except TypeError as error:
        return str(error)
    except ValueError:  # some builtins have no signature
        return None
    return None


class _FunctionReward:
    def __init__(self, function: RewardFunction | RewardClass) -> None:
        self._function, self.name = function, _name(function)

    def bind(self, manifest: Manifest) -> BoundReward:
        function: Any = self._function
        return _BoundFunction(function if class_of(function) is None else instantiate(function), manifest)


def is_custom(reward: Reward) -> bool:
    """Return whether a reward calls a function or class of the user's."""
    return isinstance(reward, _FunctionReward)


def instantiate(kind: Any) -> Any:
    """Create an object of a class without arguments, or with those of a partial.

    Raises:
        InvalidConfig: the class needs other arguments.
    """
    try:
        return kind()
    except (TypeError, ValueError) as error:
        raise InvalidConfig(
            f"reward: {_name(kind)} cannot be instantiated without arguments ({error}); pass an object or a "
            "functools.partial of it instead"
        ) from None


class _UnknownPoint(KeyError):
    """A point that the node does not have; a custom function may catch it, as any KeyError."""


class _Values(dict[str, Any]):
    """Values by name, whose KeyError can be distinguished from others in a custom function.

    It contains the observed points, so that a function of all of them does not depend on points added for pictures;
    `values[name]` reads the others too.
    """

    def __init__(self, observed: Iterable[tuple[str, Any]], unobserved: Mapping[str, Any]) -> None:
        super().__init__(observed)
        self._unobserved = unobserved

    def __missing__(self, name: Any) -> Any:
        if name in self._unobserved:
            return self._unobserved[name]
        raise _UnknownPoint(name)


class NamedValues:
    """The values of a sample by name, as a custom function receives them."""

    def __init__(self, manifest: Manifest) -> None:
        self.names = manifest.names
        self._observed = None if manifest.observed_names == self.names else [p.observed for p in manifest.points]

    def __call__(self, values: Iterable[Any]) -> dict[str, Any]:
        """Return the values of all points, in manifest order, by name."""
        if self._observed is None:
            return _Values(zip(self.names, values, strict=True), {})
        entries = list(zip(self.names, values, strict=True))
        unobserved = dict(entry for entry, observed in zip(entries, self._observed, strict=True) if not observed)
        return _Values((entry for entry, observed in zip(entries, self._observed, strict=True) if observed), unobserved)


class _BoundFunction(BoundReward):
    def __init__(self, function: RewardFunction, manifest: Manifest) -> None:
        self._function, self._values = function, NamedValues(manifest)

    def __call__(self, values: Floats, begin: Begin) -> Outcome:
        columns = values.tolist() if values.ndim == 1 else np.moveaxis(values, -1, 0)
        result = self._evaluate(self._values(columns), begin)
        has_terms = isinstance(result, Mapping)
        named = result if has_terms else {"reward": result}
        if not named:
            raise InvalidConfig(
                f"reward: {_name(self._function)} returned no terms; a number for each of them expected"
            )
        terms: Terms = {
            str(name): finite_term(self._function, name, term, values.shape[:-1], is_total=not has_terms)
            for name, term in named.items()
        }
        total = sum(terms.values(), np.zeros(values.shape[:-1])[()])
        return Outcome(total, terms, {})

    def _evaluate(self, values: dict[str, Any], begin: Begin) -> Any:
        """Call the function; add the reward's name to what it raises."""
        try:
            return self._function(values, begin)
        except _UnknownPoint as error:
            name = error.args[0]
            raise UnknownName(
                f"reward: {_name(self._function)} reads {name!r}, which the node does not have; "
                f"{did_you_mean(str(name), self._values.names)}"
            ) from error
        except Exception as error:
            error.add_note(f"in the reward {_name(self._function)}")
            raise

    def reset(self, slots: Sequence[int] | None = None) -> None:
        if callable(reset := getattr(self._function, "reset", None)):
            reset(slots)

    def state(self) -> dict[str, Any]:
        if self._has_own_state():
            return dict(self._function.state())  # type: ignore[attr-defined]
        attributes = _attributes(self._function)
        try:
            return {ATTRIBUTES: copy.deepcopy(attributes)} if attributes else {}
        except Exception as error:
            raise InvalidConfig(
                f"reward: the attributes of {_name(self._function)} cannot be copied for a snapshot or branch "
                f"({type(error).__name__}: {error}); give it state() and restore(state)"
            ) from error

    def restore(self, state: dict[str, Any]) -> None:
        if self._has_own_state():
            self._function.restore(state)  # type: ignore[attr-defined]
        else:
            attributes = _attributes(self._function)
            attributes.clear()
            attributes.update(copy.deepcopy(state.get(ATTRIBUTES, {})))

    def _has_own_state(self) -> bool:
        return all(callable(getattr(self._function, method, None)) for method in ("state", "restore"))


def _attributes(function: Any) -> dict[str, Any]:
    """Return the attributes of a callable object, or of that of a method; none of a function."""
    owner = function.__self__ if inspect.ismethod(function) else function
    attributes = {} if inspect.isroutine(owner) else getattr(owner, "__dict__", {})
    return attributes if isinstance(attributes, dict) else {}


def finite_term(function: Any, name: object, term: Any, shape: tuple[int, ...] = (), *, is_total: bool = False) -> Any:
    """Return what a reward function returned for a term, for an agent or in total, as a number or an array.

    Raises:
        InvalidConfig: it is not finite, or cannot have that shape.
    """
    try:
        if np.asarray(term).dtype.kind in "SU":  # text, which NumPy would parse
            raise TypeError
        array = np.broadcast_to(np.asarray(term, np.float64), shape)
    except (TypeError, ValueError, OverflowError):
        array = None
    if array is None or not np.isfinite(array).all():
        raise InvalidConfig(
            f"reward: {_name(function)} returned {term!r} for {name!r}; a finite number expected"
            + (f", or an array of shape {shape}" if shape else "")
            + (", or a mapping of terms to numbers" if is_total else "")
        )
    return float(array) if not shape else array


def _name(function: Any) -> str:
    function = function.func if isinstance(function, partial) else function
    return str(getattr(function, "__name__", type(function).__name__))
