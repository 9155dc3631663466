"""Late and taken, late and refused: a ZeroMQ controller hears which of the two it was."""

import pytest

pytest.importorskip("zmq", reason="pyzmq is not installed")

from support.nodes import SMALL, NodeProgram
from support.zeromq import GatewayProgram, Peer, keeping

import zenostat
from zenostat.topics.messages import EventKind, Manifest, Policy, Sample


@pytest.mark.slow
def test_zeromq__command_that_is_taken_after_the_deadline_is_accepted(scratch):
    """deadline 1 ms, policy wait: each command comes after its deadline, and each is taken"""
    late = {**SMALL, "policy": Policy.WAIT, "deadline_s": 0.001}
    with (
        NodeProgram(scratch / "node", **late) as node,
        GatewayProgram(node.endpoint) as gateway,
        Peer(gateway) as peer,
        Peer(gateway) as watcher,
        zenostat.connect(node.endpoint, affinity="off") as bus,
    ):
        watcher.listen("event")
        watcher.listen("manifest")
        watcher.hear(Manifest)  # the gateway knows of both subscriptions
        peer.listen("sample")
        assert peer.ask("rpc/claim/c", controller="c")[0] == "Ack"
        sample: Sample | None = None
        for _ in range(90):
            sample = peer.after(sample)
            assert peer.ask("command/c", **keeping(sample))[0] == "Ack"
            if bus.status("office").statistics.accepted_late:
                break
        event = watcher.event(EventKind.ACCEPTED_LATE)
        assert event.source == "c"
        assert (event.late_s or 0.0) > 0.0
        sample = peer.after(sample)
        stale = peer.ask("command/c", **keeping(sample, step=[0]))
        assert stale[0] == "ErrorReply"
        assert "answers episode [0] step [0]" in stale[1]["message"]
        assert watcher.event(EventKind.LATE).source == "c"
        status = bus.status("office")
    (controller,) = status.controllers
    assert (controller.late, status.late) == (1, 1)
    assert controller.accepted_late == status.statistics.accepted_late == 1
