"""Every error that Zenostat raises on purpose.

    ZenostatError
    ├── UsageError              a mistake of this side; nothing was started
    │   ├── UnknownName         a building, weather, point or controller that is not there
    │   ├── InvalidConfig       a setting or a combination of settings that cannot be
    │   │   └── UnknownArgument an argument that is not there; a TypeError as well
    │   └── InvalidAction       an action of the wrong shape, out of bounds or not finite
    ├── PeerError               a mistake of the other side of the bus
    │   ├── BadMessage          malformed, oversized, of another schema version
    │   ├── RequestRejected             a request or command that the node did not take, and why
    │   ├── EpisodeChanged      the episode was reset or stopped under a controller
    │   └── EpisodeAborted      the node's policy ended the episode: a controller gave no command
    ├── SimulatorError          EnergyPlus did not do its part
    │   ├── ModelError        EnergyPlus refused the model or gave up; `lines` of eplusout.err
    │   ├── EngineDied          the engine process ended without a word
    │   │   └── EngineUnresponsive  it neither answered nor used processor time, and was killed
    │   └── ForkFailed          the system could not fork an engine, for want of memory or processes
    └── BusError                the way to the other side
        ├── AddressInUse       another program listens there
        ├── NameInUse           a node of that name is on the bus already
        ├── NodeNotFound        nobody answers at that endpoint or under that name
        └── NodeLost            a node that was there is gone

An error crosses a process border as `{"error": class name, "message": text}` and is raised there
again as the same class.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable
from typing import TypeVar

T = TypeVar("T")
_SMALL = 4096


class ZenostatError(Exception):
    """The root; `except ZenostatError` catches whatever Zenostat raises on purpose."""


class UsageError(ZenostatError):
    """A mistake of this side; nothing was started."""


class UnknownName(UsageError):
    """A name that is not there; the text lists near ones."""


class InvalidConfig(UsageError):
    """A setting, or a combination of settings, that cannot be."""


class UnknownArgument(InvalidConfig, TypeError):
    """A keyword argument that is not there; a `TypeError` too, which other libraries probe for."""


class InvalidAction(UsageError):
    """An action of the wrong shape, out of its bounds, or not finite."""


class PeerError(ZenostatError):
    """A mistake of the other side of the bus."""


class BadMessage(PeerError):
    """A message that is malformed, oversized, or of another schema version."""


class RequestRejected(PeerError):
    """A request or command that the node did not take, with its reason."""


class EpisodeChanged(PeerError):
    """The episode was reset or stopped by somebody else."""


class EpisodeAborted(PeerError):
    """The node's policy ended the episode, since a controller had gone or gave no command in time."""


class SimulatorError(ZenostatError):
    """EnergyPlus did not do its part."""


class ModelError(SimulatorError):
    """EnergyPlus refused the model or gave up; the text has the lines of eplusout.err that matter."""


class EngineDied(SimulatorError):
    """The engine process ended without a word."""


class EngineUnresponsive(EngineDied):
    """The engine process neither answered nor used processor time for as long as the node allows, and was killed."""


class ForkFailed(SimulatorError):
    """The system could not fork an engine; the engine itself goes on."""


class BusError(ZenostatError):
    """The way to the other side does not work."""


class AddressInUse(BusError):
    """Another program listens at that endpoint."""


class NameInUse(BusError):
    """A node of that name is on the bus already."""


class NodeNotFound(BusError):
    """Nobody answers at that endpoint or under that name."""


class NodeLost(BusError):
    """A node that was there is gone."""


def _tree(cls: type[ZenostatError]) -> Iterable[type[ZenostatError]]:
    yield cls
    for child in cls.__subclasses__():
        yield from _tree(child)


_BY_NAME = {cls.__name__: cls for cls in _tree(ZenostatError)}


def to_wire(error: BaseException) -> dict[str, str]:
    """What a process says of `error` to another; a stranger's exception keeps its type's name."""
    if isinstance(error, ZenostatError):
        return {"error": type(error).__name__, "message": str(error)}
    return {"error": "ZenostatError", "message": f"{type(error).__name__}: {error}"}


def from_wire(said: dict[str, str]) -> ZenostatError:
    """The exception that another process described with `to_wire`."""
    return _BY_NAME.get(said.get("error", ""), ZenostatError)(said.get("message", "no reason given"))


class ErrorCollector:
    """Gathers mistakes, so that all of them are said at once."""

    def __init__(self) -> None:
        self.found: list[ZenostatError] = []

    def collect(self, do: Callable[[], T]) -> T | None:
        """What `do` gives, or None and its mistake gathered."""
        try:
            return do()
        except (UsageError, SimulatorError) as error:
            self.found.append(error)
            return None

    def raise_if_any(self) -> None:
        """Raises what was gathered, each on a line of its own; `InvalidConfig` if of several kinds."""
        kinds = {type(error) for error in self.found}
        if self.found:
            raise (kinds.pop() if len(kinds) == 1 else InvalidConfig)("\n".join(map(str, self.found)))


def _candidates(folded: str, names: list[str]) -> list[str]:
    """The names, folded; of very many, which would take half a second to compare, those that begin alike."""
    all_folded = [name.casefold() for name in names]
    if len(names) <= _SMALL:
        return all_folded
    return [name for name in all_folded if name[:2] == folded[:2] and abs(len(name) - len(folded)) <= 3]


def did_you_mean(name: str, known: Iterable[str], *, most: int = 5) -> str:
    """`name`'s nearest neighbours among `known`, as the end of an error text.

    Names that contain the text come first, then those that are spelled alike.
    """
    names = list(dict.fromkeys(known))
    if not names:
        return "there are none"
    folded = name.casefold()
    parts = [n for n in names if folded and folded in n.casefold()]
    alike = difflib.get_close_matches(folded, _candidates(folded, names), n=most, cutoff=0.5)
    by_fold = {n.casefold(): n for n in names}
    picked = list(dict.fromkeys(parts + [by_fold[a] for a in alike]))[:most]
    if picked:
        return "near names: " + ", ".join(repr(n) for n in picked)
    shown = ", ".join(repr(n) for n in names[:most])
    return f"there are: {shown}" + (f" and {len(names) - most} more" if len(names) > most else "")
