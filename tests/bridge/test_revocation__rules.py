"""Revocation in the step exchange, and the permissions of senders: no bus."""

import socket
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import pytest
from support.builders import NAN, advance, answer, claim, exchange, ruling
from support.exchange_checks import same

from zenostat.bridge.exchange.revocation import revoke
from zenostat.bridge.node.access import Access
from zenostat.bridge.transport.deny_list import shut_down
from zenostat.topics import keys
from zenostat.topics.keys import Role
from zenostat.topics.messages import EventKind, Write

NAMES = {
    "ppo-7": (Role.CONTROLLER,),
    "rbc": (Role.CONTROLLER,),
    "panel": (Role.OPERATOR,),
    "screen": (Role.MONITOR,),
    "zmq": (Role.GATEWAY,),
    "node": (Role.NODE,),
}


def test_revoke__relinquishes_all_values_of_a_name_and_the_names_below_it_alone() -> None:
    at = exchange()
    claim(at, "ppo-7.a")
    answer(at, "ppo-7.a", [20.0, 25.0])
    at.intake.write("heat", Write(value=21.0, priority=5, source="ppo-7"), 0.0)
    at.intake.write("cool", Write(value=26.0, priority=6, source="ppo-70", duration_s=60.0), 0.0)
    at.intake.write("cool", Write(value=27.0, priority=5, source="ppo-7.b", duration_s=60.0), 0.0)
    (event,) = revoke(at, "ppo-7")
    assert (event.kind, event.source) == (EventKind.REVOKED, "ppo-7")
    assert event.text == "ppo-7 is revoked; released: ppo-7.a; relinquished: heat, cool"
    assert same(ruling(at)[0], [NAN, 26.0])
    assert at.claims.by_name == {}
    assert at.claims.required == []
    assert [source for _, source in at.commands.expire(61.0)] == ["ppo-70"]


def test_revoke__does_not_wait_for_the_name_and_waits_for_others() -> None:
    at = exchange()
    claim(at, "ppo-7", actuators=["heat"])
    claim(at, "rbc", actuators=["cool"])
    assert set(at.awaiting()) == {"ppo-7", "rbc"}
    revoke(at, "ppo-7")
    assert at.awaiting() == ["rbc"]
    assert not at.ready_to_step()


def test_revoke__of_a_name_that_has_nothing_changes_nothing() -> None:
    at = exchange()
    claim(at, "rbc")
    answer(at, "rbc", [20.0, 25.0])
    (event,) = revoke(at, "ppo-7")
    assert event.text == "ppo-7 is revoked"
    assert at.ready_to_step()
    advance(at)


@pytest.mark.parametrize(
    ("topic", "sender", "reason"),
    [
        (keys.COMMAND, "ppo-7", ""),
        (keys.COMMAND, "ppo-7.a", ""),
        (keys.COMMAND, "ppo-70", "is in no certificate's name"),
        (keys.WRITE_REQUEST, "ppo-7", "controller 'ppo-7' may not send rpc/write"),
        (keys.WRITE_REQUEST, "panel", ""),
        (keys.CLAIM, "panel.a", "operator 'panel' may not send rpc/claim"),
        (keys.CLAIM, "screen", "monitor 'screen' may not send"),
        (keys.CLAIM, "zmq.a", ""),
        (keys.WRITE_REQUEST, "zmq.a", ""),
        (keys.RESET, "node.x", ""),
        (keys.STOP, "panel", ""),
        (keys.STOP, "zmq", ""),
        (keys.STOP, "ppo-7", "may not stop a node"),
    ],
)
def test_access__denial_is_by_role(topic: keys.Topic, sender: str, reason: str) -> None:
    denial = Access(NAMES, frozenset).denial(topic, sender)
    assert reason in denial if reason else denial == ""


def test_access__branch_is_ended_by_its_owner() -> None:
    branch = Access(NAMES, frozenset).of_branch("ppo-7.env-1")
    assert branch.denial(keys.STOP, "ppo-7") == branch.denial(keys.STOP, "panel") == ""
    assert branch.denial(keys.STOP, "rbc") == "'rbc' may not end a branch of 'ppo-7.env-1'"


def test_access__revoked_name_is_denied_from_the_next_message_on() -> None:
    revoked: set[str] = set()
    access = Access(NAMES, lambda: revoked)
    assert access.denial(keys.COMMAND, "ppo-7.a") == ""
    revoked.add("ppo-7")
    assert access.denial(keys.COMMAND, "ppo-7.a") == "ppo-7 is revoked"
    assert access.denial(keys.COMMAND, "rbc") == ""


@pytest.mark.parametrize("locator", ["tls/127.0.0.1:{}", "tls/[::ffff:127.0.0.1]:{}?rel=0"])
def test_shut_down__ends_the_link_of_one_address_not_of_another_with_the_same_port(locator: str) -> None:
    """Two peers on two hosts may have the same port."""
    with ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

        def connected(host: str, port: int) -> tuple[socket.socket, socket.socket]:
            peer = stack.enter_context(socket.socket())
            peer.bind((host, port))
            peer.connect(("127.0.0.1", listener.getsockname()[1]))
            peer.settimeout(20)
            return peer, stack.enter_context(listener.accept()[0])

        revoked, _ = connected("127.0.0.1", 0)
        port = revoked.getsockname()[1]
        other, accepted = connected("127.0.0.2", port)
        link: Any = SimpleNamespace(dst=locator.format(port))
        shut_down([link])
        assert revoked.recv(1) == b"", "it is ended"
        accepted.sendall(b"x")
        assert other.recv(1) == b"x"
