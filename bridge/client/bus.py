"""The client of the bus, without Gymnasium.

with zenostat.connect("tcp/127.0.0.1:7447") as bus:
    for sample in bus.controller("office"):
        sample.send({"core_zn_cooling_setpoint": 26.0})
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from datetime import datetime
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TypeVar

from zenostat.bridge.client.connection import Connection, build
from zenostat.bridge.client.controller_link import ControllerLink, open_link
from zenostat.bridge.client.history import History, first_step, groups, join_points, join_replies, last_step, row_count
from zenostat.bridge.client.listener import listen
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.client.trials import CommandValues, trial_request, tried_samples
from zenostat.bridge.runtime import affinity
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.runtime.contention import FollowedPlacement, own_threads
from zenostat.bridge.transport.session import DEFAULT_ENDPOINT, names_certificate, open_session
from zenostat.topics import keys
from zenostat.topics.errors import EpisodeChanged, InvalidConfig, RequestRejected, UnknownName, did_you_mean
from zenostat.topics.keys import Role
from zenostat.topics.messages import (
    Ack,
    Acknowledge,
    AlarmList,
    AlarmQuery,
    HistoryQuery,
    HistorySeries,
    Manifest,
    OnFull,
    RecordingStatus,
    RemoveFromService,
    ReturnToService,
    Shelve,
    StartRecording,
    StopRecording,
    Unshelve,
)

E = TypeVar("E", bound=StrEnum)
_CLIENT_ROLES = (Role.CONTROLLER, Role.OPERATOR, Role.MONITOR, Role.GATEWAY)


def connect(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    wait: bool = False,
    affinity: Affinity = Affinity.SEPARATE_CORES,
    core: int | None = None,
    local_node: int | None = None,
    keys: Path | str | None = None,
    role: Role | str | Collection[Role | str] | None = None,
    certificate: str | None = None,
    warn: Callable[[str], object] | None = None,
) -> Bus:
    """Connect to the bus at `endpoint`; use the result in a `with` statement.

    Args:
        endpoint: `tcp/HOST:PORT`, `unixsock-stream/PATH`, or, with `keys`, `tls/HOST:PORT`.
        wait: Keep trying in the background instead of failing.
        affinity: Placement of this process's bus threads; see `zenostat.bridge.runtime.affinity`.
        core: The node's core, if it is already known.
        local_node: Process id of the node on that core; the bus threads leave the core while the node does.
        keys: A folder created by `zenostat keys init`, or a certificate in it (`FOLDER/NAME.pem`).
        role: The role that the certificate must have: `controller`, the default, or `operator`, `monitor`, `gateway`;
            several for a program that needs the rights of all, such as a controller and operator that also resets.
        certificate: Name of the certificate; by default that of the role, of several roles `trainer`.
        warn: Called with the date on which the certificate expires, if that is soon; None is `warnings.warn`.

    Raises:
        NodeNotFound: No process listens at the endpoint, or the TLS session failed.
        InvalidConfig: The endpoint is malformed, or the keys cannot be used.
        UnknownName: There is no such role or affinity.
    """
    placement = _member(Affinity, affinity, "affinity")
    named = [role] if isinstance(role, str) else role or ()
    required = [_member(Role, each, "role", _CLIENT_ROLES) for each in named]
    folder = None if keys is None else Path(keys)
    if core is None or placement is not Affinity.SEPARATE_CORES:
        local_node = None
    before = set() if local_node is None else own_threads()
    warn = warn or partial(warnings.warn, stacklevel=3)
    with _thread_placement(placement, core):
        if not required and not names_certificate(folder, certificate):
            required = [Role.CONTROLLER]
        session = open_session(
            connect=[endpoint], wait=wait, keys=folder, role=required, certificate=certificate, warn=warn
        )
    bus = Bus(endpoint, session, placement)
    if core is not None and local_node is not None:
        bus.placement = FollowedPlacement(local_node, core, own_threads() - before)
    return bus


def _member(kind: type[E], value: str, what: str, known: Iterable[E] = ()) -> E:
    """Return a member of an enumeration; `UnknownName` if there is none of that value, or none that is known."""
    members = {str(member): member for member in known or kind}
    if str(value) not in members:
        raise UnknownName(f"there is no {what} {value!r}; {did_you_mean(str(value), members)}")
    return members[str(value)]


class Bus(Connection):
    """A connection to all nodes that are reachable through one endpoint.

    Attributes:
        endpoint: Its endpoint.
        identity: The name in its certificate; empty without keys.
        roles: The roles of its certificate; none without keys.
        session: The Zenoh session.
        timer: For the checks of controllers that have waited for long; its thread starts with the first controller.
    """

    def listen(self, node: str) -> AbstractContextManager[Iterator[SampleView]]:
        """Receive all samples of a node from now on: `with bus.listen("office") as samples:`.

        A listener that lags by more than about ten thousand samples misses the oldest.

        Raises:
            NodeNotFound: No such node.
            NodeLost: The node is gone, or the connection to it is lost; raised by the iterator.
        """
        return listen(self, node)

    def controller(
        self,
        node: str,
        *,
        name: str = "controller",
        priority: int = 10,
        actuators: list[str] | None = None,
        required: bool = True,
    ) -> ControllerLink:
        """Connect a controller to a node and claim actuators at a priority.

        It holds them until it is closed, by `close` or as a context manager, or until this connection is closed.

        Args:
            node: The node's name.
            name: The controller's name; made unique on the bus.
            priority: 1 (highest) to 16; 8 is a manual operator's.
            actuators: Names of actuators; None claims all.
            required: Whether the node waits for this controller in lockstep.

        Raises:
            InvalidConfig: A name, priority or actuators of another form.
            NodeNotFound: No such node.
            RequestRejected: The node has no actuator of one of the names, or another controller holds one at that
                priority.
        """
        return open_link(self, node, name=name, priority=priority, actuators=actuators, required=required)

    # Trials

    def try_step(
        self, node: str, alternatives: Sequence[CommandValues], *, name: str = "trial", priority: int = 10
    ) -> list[SampleView]:
        """Return the next sample under each of several alternative commands, while the node stays at its sample.

        Args:
            node: The node's name.
            alternatives: 1 to 256 commands, each as in `ControllerLink.send`.
            name: Name of the sender. That of a controller, such as `ControllerLink.name`, tries that controller's
                commands; any other name tries commands of all actuators at `priority`.
            priority: 1 (highest) to 16; of a name without a claim.

        Raises:
            NodeNotFound: No such node.
            InvalidAction, InvalidConfig: A command that does not fit the node, or too many; nothing was sent.
            RequestRejected: No episode is running, or a value is out of bounds; nothing was simulated.
            ForkFailed: The plant cannot be copied.
            SimulatorError: A copy failed; the node continues.
        """
        sequences = [[values] for values in alternatives]
        return [sample for (sample,) in self.try_steps(node, sequences, name=name, priority=priority)]

    def try_steps(
        self, node: str, alternatives: Sequence[Sequence[CommandValues]], *, name: str = "trial", priority: int = 10
    ) -> list[list[SampleView]]:
        """Return the next samples under each of several sequences of commands; see `try_step`.

        Args:
            node: The node's name.
            alternatives: The commands of each timestep, for each alternative; equally many for all.
            name: As of `try_step`.
            priority: As of `try_step`.

        Returns:
            Of each alternative, a sample for each timestep, at most until the episode ends.
        """
        manifest = self.manifest(node)
        request = trial_request(manifest, alternatives, priority=priority)
        reply = self.trial(node, request.model_copy(update={"controller": keys.check_name(name, "a sender's name")}))
        return tried_samples(reply, len(alternatives), manifest)

    # History

    def history(
        self,
        node: str,
        points: Sequence[str] | None = None,
        *,
        slot: int = 0,
        start: datetime | str | None = None,
        end: datetime | str | None = None,
        max_samples: int | None = None,
        extremes: bool = False,
    ) -> History:
        """Return the values of points in a slot's present episode, as far as the node keeps them.

        The manifest has the number of samples that it keeps (`history_samples`).

        Args:
            node: The node's name.
            points: Names of sensors, meters and actuators; None is all of them.
            slot: Number of the slot.
            start: Simulated time, such as `07-03T06:00`, of the first sample; None is the earliest that is kept.
            end: Simulated time of the last sample; None is the latest.
            max_samples: At most this many (2 or more); of more, only every k-th is returned, the last one included,
                and `History.stride` is k. A reply of 4 MiB may limit them further.
            extremes: Also return the smallest and the largest value of the samples between those that are returned.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such point; the text lists similar names.
            InvalidConfig: A time has another form, or `max_samples` is out of range.
            RequestRejected: There is no such slot, or the node keeps no history or has no sample in that range.
            EpisodeChanged: A new episode began while the history was read.
        """
        manifest = self.manifest(node)
        names = [*manifest.names, *(a.name for a in manifest.actuators)] if points is None else list(points)
        if isinstance(points, str):
            raise InvalidConfig(f"points: a list of names expected, such as [{points!r}]")
        begin, last = first_step(manifest, start), last_step(manifest, end)
        parts: list[History] = []
        for chosen in groups(names):
            query = build(
                HistoryQuery, points=chosen, slot=slot, from_step=begin, to_step=last, max_samples=max_samples,
                extremes=extremes,
            )  # fmt: skip
            parts.append(self._history(manifest, query))
            begin, last = max(begin or 0, parts[0].oldest_step), int(parts[0].step[-1])
        return join_points(parts)

    def _history(self, manifest: Manifest, query: HistoryQuery) -> History:
        node = manifest.node
        replies = [self.ask(keys.HISTORY, node, query, HistorySeries)]
        while replies[-1].remaining:
            last, following = replies[-1], replies[-1].first_step + row_count(replies[-1])
            query = query.model_copy(update={"from_step": following, "to_step": following + last.remaining - 1})
            reply = self.ask(keys.HISTORY, node, query, HistorySeries)
            if reply.episode != last.episode:
                raise EpisodeChanged(f"node {node!r} began a new episode while its history was read")
            if reply.first_step != following:
                raise RequestRejected(f"node {node!r} replaced samples while they were read; request fewer points")
            replies.append(reply)
        return join_replies(manifest, query.slot, replies)

    # Recordings

    def record(
        self,
        node: str,
        path: str | Path,
        *,
        now: bool = False,
        overwrite: bool = False,
        on_full: OnFull | str = OnFull.WAIT,
        source: str = "",
    ) -> RecordingStatus:
        """Let a node record everything to a file on its machine, from the next reset of all slots; return its state.

        Args:
            node: The node's name.
            path: Absolute path of a file with the suffix `.mcap`, or of a folder, on the node's machine.
            now: Begin at once; what is before the next reset cannot be verified.
            overwrite: Replace a recording at that path.
            on_full: If the disk is slower than the node, `wait` for it, or `stop` the recording.
            source: Name of the requester, for the event that reports it.

        Raises:
            InvalidConfig: The file exists (with `overwrite`: and is not a recording, or another node is writing to it)
                or cannot be created, its suffix is another one, or `on_full` is neither.
            RequestRejected: The node is recording already, the path is relative, or its folder does not exist.
        """
        request = build(StartRecording, path=str(path), now=now, overwrite=overwrite, on_full=on_full, source=source)
        return self.ask(keys.RECORD, node, request, RecordingStatus)

    def stop_recording(self, node: str, *, source: str = "") -> RecordingStatus:
        """End a node's recording; return its state once the file is complete.

        Raises:
            RequestRejected: The node is not recording.
        """
        return self.ask(keys.STOP_RECORDING, node, StopRecording(source=source), RecordingStatus)

    # Alarms

    def alarms(self, node: str, *, slot: int = 0) -> AlarmList:
        """Return all alarms of a slot with their states, in the order of the rules; without rules there are none.

        Raises:
            NodeNotFound: No such node.
            RequestRejected: There is no such slot.
        """
        return self.ask(keys.ALARMS, node, build(AlarmQuery, slot=slot), AlarmList)

    def acknowledge(
        self, node: str, alarm: str, *, slot: int | None = None, source: str = "", comment: str = ""
    ) -> Ack:
        """Acknowledge alarms; the text of the reply has a line for each.

        Args:
            node: The node's name.
            alarm: Name of an alarm, or of a rule for all of its points; `*` stands for any characters.
            slot: Number of the slot; None is all of them.
            source: Name of who acknowledges, at most 128 characters.
            comment: For the record, at most 500 characters.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: There is no such slot, or none of these alarms awaits an acknowledgment.
        """
        request = build(Acknowledge, alarm=alarm, slot=slot, source=source, comment=comment)
        return self.ask(keys.ACKNOWLEDGE, node, request, Ack)

    def shelve(
        self, node: str, alarm: str, duration_s: float, *, slot: int | None = None, source: str = "", comment: str = ""
    ) -> Ack:
        """Shelve alarms: for a time they alert nobody. For a shelved alarm, the time begins anew.

        Args:
            node: The node's name.
            alarm: Name of an alarm, or of a rule for all of its points; `*` stands for any characters.
            duration_s: Simulated seconds, rounded up to whole timesteps; at most the `max_shelve_s` of the rule.
            slot: Number of the slot; None is all of them.
            source: Name of who shelves, at most 128 characters.
            comment: For the record, at most 500 characters.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: There is no such slot, the time is too long, or these alarms are out of service.
        """
        request = build(Shelve, alarm=alarm, duration_s=duration_s, slot=slot, source=source, comment=comment)
        return self.ask(keys.SHELVE, node, request, Ack)

    def unshelve(self, node: str, alarm: str, *, slot: int | None = None, source: str = "", comment: str = "") -> Ack:
        """End the shelving of alarms; those that are off-normal become active. Arguments: see `acknowledge`.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: There is no such slot, or none of these alarms is shelved.
        """
        request = build(Unshelve, alarm=alarm, slot=slot, source=source, comment=comment)
        return self.ask(keys.UNSHELVE, node, request, Ack)

    def remove_from_service(
        self,
        node: str,
        alarm: str,
        duration_s: float | None = None,
        *,
        slot: int | None = None,
        source: str = "",
        comment: str = "",
    ) -> Ack:
        """Remove alarms from service, for example while a sensor is repaired: they alert nobody until returned.

        Args:
            node: The node's name.
            alarm: Name of an alarm, or of a rule for all of its points; `*` stands for any characters.
            duration_s: Simulated seconds after which they are returned, at most a year; None is no limit.
            slot: Number of the slot; None is all of them.
            source: Name of who removes them, at most 128 characters.
            comment: For the record, at most 500 characters.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: There is no such slot.
        """
        request = build(
            RemoveFromService, alarm=alarm, duration_s=duration_s, slot=slot, source=source, comment=comment
        )
        return self.ask(keys.REMOVE_FROM_SERVICE, node, request, Ack)

    def return_to_service(
        self, node: str, alarm: str, *, slot: int | None = None, source: str = "", comment: str = ""
    ) -> Ack:
        """Return alarms to service; those that are off-normal become active. Arguments: see `acknowledge`.

        Raises:
            NodeNotFound: No such node.
            UnknownName: No such alarm; the text lists similar names.
            RequestRejected: There is no such slot, or none of these alarms is out of service.
        """
        request = build(ReturnToService, alarm=alarm, slot=slot, source=source, comment=comment)
        return self.ask(keys.RETURN_TO_SERVICE, node, request, Ack)


def _thread_placement(placement: Affinity, core: int | None) -> AbstractContextManager[None]:
    if placement is Affinity.TOGETHER:
        affinity.set_affinity(core)
    return affinity.threads_started_on(None if placement is Affinity.OFF else core)
