"""A user's own reward: a function, or a class of a few lines."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent_sdk.rewards.base import Begin, BoundReward, Outcome, Reward, Terms
from topics.errors import InvalidConfig, UnknownName, did_you_mean
from topics.messages import Manifest

RewardFunction = Callable[[Mapping[str, Any], Any], Mapping[str, Any] | float]
"""`(values, begin)`: values by the names of sensors and meters, and when the timestep began; gives the reward or its
terms by name."""


def from_function(function: RewardFunction | type) -> Reward:
    """A function as a reward.

    Args:
        function: called once a timestep, and once at the first sample to learn the names of its terms,
            with the values by name (floats; arrays of the leading shape where there are
            several slots) and the time at which it began. It gives the reward, or terms by name of which the reward is
            the sum. An object that can be called may have `reset(slots)`, `state()` and `restore(state)` as well; see
            `BoundReward`. A class is made anew, without arguments, for each environment.

    Raises:
        InvalidConfig: it cannot be called with two things; later, it gave something that is no reward.
        UnknownName: later, it asked for a point that the node does not have. Its other exceptions are its own; a note
            names the reward.
    """
    fault = _misfit(function)
    if fault is not None:
        raise InvalidConfig(f"reward: {_name(function)} should take (values, begin): {fault}")
    return _OfFunction(function)


def _misfit(function: RewardFunction | type) -> str | None:
    """Why it cannot be called with values and a time; None if it can, or does not tell."""
    if isinstance(function, type) and not any("__call__" in vars(base) for base in function.__mro__):
        return "it has no __call__"
    called: Any = function.__call__ if isinstance(function, type) else function
    itself = [None] if isinstance(function, type) else []
    try:
        inspect.signature(called).bind(*itself, None, None)
    except TypeError as error:
        return str(error)
    except ValueError:  # some builtins have no signature
        return None
    return None


class _OfFunction:
    def __init__(self, function: RewardFunction | type) -> None:
        self._function = function

    def bind(self, manifest: Manifest) -> BoundReward:
        """See `Reward.bind`."""
        return _Bound(made(self._function) if isinstance(self._function, type) else self._function, manifest)


def made(kind: type) -> Any:
    """An object of a class that takes no arguments; `InvalidConfig` if it wants some."""
    try:
        return kind()
    except (TypeError, ValueError) as error:
        raise InvalidConfig(
            f"reward: {kind.__name__} cannot be made without arguments ({error}); give an object of it"
        ) from None


class _NoPoint(KeyError):
    """A point that is not there; a function may expect it, as any KeyError."""


class _Values(dict[str, Any]):
    """Values by name; a KeyError of theirs is told from others in a user's function."""

    def __missing__(self, name: Any) -> Any:
        raise _NoPoint(name)


class _Bound(BoundReward):
    def __init__(self, function: RewardFunction, manifest: Manifest) -> None:
        self._function, self._names = function, manifest.names

    def __call__(self, values: NDArray[np.float64], begin: Begin) -> Outcome:
        columns = values.tolist() if values.ndim == 1 else np.moveaxis(values, -1, 0)
        given = self._ask(_Values(zip(self._names, columns, strict=True)), begin)
        said = given if isinstance(given, Mapping) else {"reward": given}
        terms: Terms = {str(name): self._term(name, term, values.shape[:-1]) for name, term in said.items()}
        total = sum(terms.values(), np.zeros(values.shape[:-1])[()])
        return Outcome(total, terms, {})

    def _ask(self, values: _Values, begin: Begin) -> Any:
        """What the function gives; what it raises is told to be the reward's."""
        try:
            return self._function(values, begin)
        except _NoPoint as error:
            name = error.args[0]
            raise UnknownName(
                f"reward: {_name(self._function)} asks for {name!r}, which the node does not have; "
                f"{did_you_mean(str(name), self._names)}"
            ) from error
        except Exception as error:
            error.add_note(f"in the reward {_name(self._function)}")
            raise

    def _term(self, name: object, term: Any, shape: tuple[int, ...]) -> Any:
        try:
            array = np.broadcast_to(np.asarray(term, np.float64), shape)
        except (TypeError, ValueError):
            array = None
        if array is None or not np.isfinite(array).all():
            raise InvalidConfig(
                f"reward: {_name(self._function)} gave {name!r}: {term!r}; a finite number expected"
                + (f", or an array of shape {shape}" if shape else "")
            )
        return float(array) if not shape else array

    def reset(self, slots: Sequence[int] | None = None) -> None:
        if callable(begin := getattr(self._function, "reset", None)):
            begin(slots)

    def state(self) -> dict[str, Any]:
        remembered = getattr(self._function, "state", None)
        return dict(remembered()) if callable(remembered) else {}

    def restore(self, state: dict[str, Any]) -> None:
        if callable(again := getattr(self._function, "restore", None)):
            again(state)


def _name(function: Any) -> str:
    return str(getattr(function, "__name__", type(function).__name__))
