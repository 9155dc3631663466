"""One thread at a time in the methods of an object; a second one is refused."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

from zenostat.topics.errors import BusError, EpisodeChanged, UsageError

P = ParamSpec("P")
R = TypeVar("R")
S = TypeVar("S", bound="_Guarded")
Method = Callable[Concatenate[S, P], R]


class _Guarded(Protocol):
    _busy: bool


def one_thread(
    refusal: str, explain: Callable[[Any], None] = lambda _: None, interrupted: Callable[[Any], None] = lambda _: None
) -> Callable[[Method[S, P, R]], Method[S, P, R]]:
    """Return a decorator of the methods that one thread at a time may call; the object has `_busy`, at first False.

    Args:
        refusal: text of the `UsageError` that any other thread gets meanwhile.
        explain: called with the object after an error of the episode or the bus; may raise another one in its place.
        interrupted: called with the object after a `KeyboardInterrupt` or another exception that is no `Exception`.
    """

    def decorate(method: Method[S, P, R]) -> Method[S, P, R]:
        @wraps(method)
        def guarded(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
            busy, self._busy = self._busy, True  # one statement without a call: CPython switches no threads within it
            if busy:
                raise UsageError(refusal)
            try:
                return method(self, *args, **kwargs)
            except (EpisodeChanged, BusError):
                explain(self)
                raise
            except Exception:
                raise
            except BaseException:
                interrupted(self)
                raise
            finally:
                self._busy = False

        return guarded

    return decorate
