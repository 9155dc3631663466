"""The errors that Zenostat raises.

    ZenostatError
    ├── UsageError              the caller's mistake; nothing was started
    │   ├── UnknownName         a building, weather, point or controller that does not exist
    │   ├── InvalidConfig       an invalid setting, or settings that exclude each other
    │   │   ├── MissingExtra    an optional package that is not installed
    │   │   └── UnknownArgument a keyword argument that does not exist; also a TypeError
    │   ├── InvalidAction       an action of the wrong shape, out of bounds or not finite
    │   └── InvalidRecording    a file that is no recording, is damaged, or does not fit what is installed
    ├── PeerError               the mistake of a peer on the bus
    │   ├── BadMessage          malformed, oversized, or of another schema version
    │   ├── RequestRejected     a request or command that the node rejected
    │   │   └── AccessDenied    under another's name, or not permitted to its sender
    │   ├── EpisodeChanged      the episode is over or has not begun, or somebody else reset or stopped it
    │   └── EpisodeAborted      the fallback policy ended the episode: a controller sent no command
    ├── SimulatorError          EnergyPlus, or another plant, failed
    │   ├── ModelError          EnergyPlus rejected the model or stopped with an error
    │   ├── PlantFailed         the code of a plant's class raised an error or returned invalid values
    │   ├── EngineDied          the engine process ended unexpectedly
    │   │   └── EngineUnresponsive  it neither answered nor used processor time, and was killed
    │   └── ForkFailed          a plant or its engine could not be copied: too little memory, or no way to copy it
    ├── BusError                a peer cannot be reached
    │   ├── AddressInUse        another program listens at that endpoint
    │   ├── NameInUse           a node or a gateway of that name is already on the bus
    │   ├── NodeNotFound        no node answers at that endpoint or under that name
    │   └── NodeLost            the node disconnected
    └── ViewerError             a recording cannot be shown or drawn

Between processes an error is sent as `{"error": class name, "message": text}`; the receiver raises the same class.
"""

from __future__ import annotations

import difflib
import heapq
import itertools
import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TypeVar

T = TypeVar("T")
Item = TypeVar("Item", bound=Hashable)
MAX_LISTED = 10
"""Number of errors that an error text lists."""

_SMALL, _COMPARED = 4096, 500
_TYPO = 0.8
"""Similarity of a name that differs by a letter or two."""


class ZenostatError(Exception):
    """Base class of all errors that Zenostat raises."""


class UsageError(ZenostatError):
    """The caller's mistake; nothing was started."""


class UnknownName(UsageError):
    """A name that does not exist; the text suggests similar ones."""


class InvalidConfig(UsageError):
    """An invalid setting, or settings that exclude each other."""


class MissingExtra(InvalidConfig):
    """An optional package that is not installed; the text has the command that installs it."""


class UnknownArgument(InvalidConfig, TypeError):
    """A keyword argument that does not exist; also a `TypeError`, which other libraries catch."""


class InvalidAction(UsageError):
    """An action of the wrong shape, out of its bounds, or not finite."""


class InvalidRecording(UsageError):
    """A file that is not a recording, is damaged, or was recorded with something that is not installed."""


class PeerError(ZenostatError):
    """The mistake of a peer on the bus."""


class BadMessage(PeerError):
    """A message that is malformed, oversized, or of another schema version."""


class RequestRejected(PeerError):
    """A request or command that the node rejected, with the reason."""


class AccessDenied(RequestRejected):
    """A message under another's name, or one that the sender's role does not permit."""


class EpisodeChanged(PeerError):
    """The episode is over or has not begun, or somebody else reset or stopped it."""


class EpisodeAborted(PeerError):
    """The fallback policy ended the episode: a controller was disconnected or sent no command in time."""


class SimulatorError(ZenostatError):
    """The simulator failed: EnergyPlus, or another plant."""


class ModelError(SimulatorError):
    """EnergyPlus rejected the model or stopped with an error; the text has the relevant lines of eplusout.err."""


class PlantFailed(SimulatorError):
    """The code of a plant's class raised an error, with its traceback, or returned values that are not valid."""


class EngineDied(SimulatorError):
    """The engine process ended unexpectedly."""


class EngineUnresponsive(EngineDied):
    """The engine process neither answered nor used processor time for the permitted time, and was killed."""


class ForkFailed(SimulatorError):
    """A plant or its engine could not be copied; it continues to run."""


class BusError(ZenostatError):
    """A peer cannot be reached."""


class AddressInUse(BusError):
    """Another program listens at that endpoint."""


class NameInUse(BusError):
    """A node of that name is already on the bus, or a gateway of the node has that name."""


class NodeNotFound(BusError):
    """No node answers at that endpoint or under that name."""


class NodeLost(BusError):
    """The node disconnected."""


class ViewerError(ZenostatError):
    """A recording cannot be shown or drawn: the viewer or a driver is missing, or the viewer failed."""


def _tree(cls: type[ZenostatError]) -> Iterable[type[ZenostatError]]:
    yield cls
    for child in cls.__subclasses__():
        yield from _tree(child)


_BY_NAME = {cls.__name__: cls for cls in _tree(ZenostatError)}


def to_wire(error: BaseException) -> dict[str, str]:
    """Return the form in which an error is sent to another process; other exceptions keep their type's name."""
    if isinstance(error, ZenostatError):
        return {"error": type(error).__name__, "message": str(error)}
    return {"error": "ZenostatError", "message": f"{type(error).__name__}: {error}"}


def from_wire(fields: dict[str, str]) -> ZenostatError:
    """Return the exception that another process sent with `to_wire`."""
    return _BY_NAME.get(fields.get("error", ""), ZenostatError)(fields.get("message", "no reason given"))


class ErrorCollector:
    """Collects errors, so that all of them are reported at once."""

    def __init__(self) -> None:
        self.errors: list[ZenostatError] = []

    def collect(self, function: Callable[[], T]) -> T | None:
        """Return the result of `function`, or None if it raises an error, which is collected."""
        try:
            return function()
        except (UsageError, SimulatorError) as error:
            self.errors.append(error)
            return None

    def raise_if_any(self) -> None:
        """Raise one error with the collected texts, each once, on lines; `InvalidConfig` if their classes differ."""
        kinds = {type(error) for error in self.errors}
        if self.errors:
            raise (kinds.pop() if len(kinds) == 1 else InvalidConfig)("\n".join(dict.fromkeys(map(str, self.errors))))


def _candidates(folded: str, names: list[str]) -> list[str]:
    """Return the names; of very many, only those that share most pairs of letters, since comparing all is slow."""
    if len(names) <= _SMALL:
        return names
    pairs = set(itertools.pairwise(folded))

    def similarity(name: str) -> float:
        own = set(itertools.pairwise(name))
        return len(pairs & own) / (len(pairs) + len(own) or 1)

    return heapq.nlargest(_COMPARED, names, similarity)


def _is_word(text: str, name: str) -> bool:
    """Return whether a name has a text as one or several whole words, of `snake_case`, `CamelCase` or others."""
    for match in re.finditer(re.escape(text), name, re.IGNORECASE):
        before, after = name[: match.start()][-1:], name[match.end() :][:1]
        begins = not before.isalnum() or (before.islower() and match[0][:1].isupper())
        if begins and (not after.isalnum() or after.isupper()):
            return True
    return False


def list_errors(head: str, errors: Sequence[str], *, limit: int = MAX_LISTED) -> str:
    """Return an error text of several lines: the head, the first errors, and how many more there are."""
    more = [f"and {len(errors) - limit} more"] if len(errors) > limit else []
    return "\n  ".join([head, *errors[:limit], *more])


def repeated(items: Iterable[Item]) -> list[Item]:
    """Return the items that occur more than once, in their order."""
    return [item for item, times in Counter(iter(items)).items() if times > 1]


def did_you_mean(name: str, known: Iterable[str], *, limit: int = 5) -> str:
    """Return the end of an error text that suggests the names in `known` nearest to `name`, whatever their case.

    The same name in another case comes first, then one that differs by its plural, names that contain the text as a
    word, those that differ by a typo, those that contain it anywhere, and those with a similar spelling.
    """
    names = list(dict.fromkeys(known))
    if not names:
        return "there are none"
    folded = name.casefold()
    by_fold: dict[str, list[str]] = {}
    for known_name in names:
        by_fold.setdefault(known_name.casefold(), []).append(known_name)
    parts = [n for n in names if folded and folded in n.casefold()]
    words = [n for n in parts if _is_word(name, n)]
    alike = difflib.get_close_matches(folded, _candidates(folded, [*by_fold]), n=limit, cutoff=0.5)
    typos = [a for a in alike if difflib.SequenceMatcher(None, a, folded).ratio() >= _TYPO]
    plural = [n for n in parts if n.casefold() in (f"{folded}s", f"{folded}es")]
    spelled, typed = ([n for a in group for n in by_fold[a]] for group in (alike, typos))
    similar = list(dict.fromkeys([*by_fold.get(folded, ()), *plural, *words, *typed, *parts, *spelled]))[:limit]
    if similar:
        *others, last = map(repr, similar)
        return "did you mean " + (f"{', '.join(others)} or {last}?" if others else f"{last}?")
    shown = ", ".join(repr(n) for n in names[:limit])
    return f"there are: {shown}" + (f" and {len(names) - limit} more" if len(names) > limit else "")
