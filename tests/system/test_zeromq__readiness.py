"""Before the gateway, or the node behind it, is ready: what comes is kept, or refused by name."""

import queue

import pytest

pytest.importorskip("zmq", reason="pyzmq is not installed")

import zenoh
import zmq
from support.nodes import free_port
from support.zeromq import GatewayProgram, Peer, gateway, module_gateway
from zenoh.handlers import Callback

import zenostat
from zenostat.gateways.zeromq import Gateway
from zenostat.topics import codec, keys
from zenostat.topics.errors import AddressInUse, NodeNotFound
from zenostat.topics.messages import ErrorReply, EventKind, Manifest, Sample

__all__ = ["gateway", "module_gateway"]


class Ports:
    """Ports on which a gateway will listen."""

    def __init__(self) -> None:
        self.publish, self.command = (f"tcp://127.0.0.1:{free_port()}" for _ in range(2))


@pytest.mark.slow
@pytest.mark.parametrize("end", ["killed", "interrupted"])
def test_sockets_older_than_the_gateway__receive_samples_and_answers(episode_bus, end):
    ports = Ports()
    at = ("--publish", ports.publish, "--command", ports.command)
    with Peer(ports) as early:  # type: ignore[arg-type]
        lost = early.requests.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        early.listen("sample")
        for _ in range(2):
            early.say("rpc/status")
            with GatewayProgram(episode_bus.endpoint, *at) as gateway:
                assert gateway.first_line.startswith("ready: all nodes of ")
                assert early.answer()[0] == "Status"
                assert early.hear(Sample).step == [0]
                assert early.ask("rpc/claim/c", controller="c")[0] == "Ack"
                if end == "interrupted":
                    assert gateway.interrupt()[0] == 0
            assert lost.poll(60_000), "its socket knows that the gateway has gone, and keeps what is sent from now on"
            lost.recv_multipart()
            while early.published.poll(0):
                early.published.recv_multipart()
        early.say("command/c", episode=[0], step=[0], values=b"")
        with GatewayProgram(episode_bus.endpoint, *at):
            assert "'c' has claimed nothing; claim first" in early.answer()[1]["message"]


def test_gateway__takes_no_requests_while_its_node_is_not_there(shared_node, gateway):
    """Requests that it had taken from its peers' queues would be lost with its sockets, which it binds after that."""
    with zenostat.connect(shared_node.endpoint, affinity="off") as bus:
        for node, error in (("absent", NodeNotFound), ("office", AddressInUse)):
            with pytest.raises(error):
                Gateway(bus.session, node, publish=gateway.publish, command=gateway.command)


@pytest.mark.slow
def test_requests__wait_for_the_manifest_of_their_node(shared_node, gateway):
    """slow's token → a request for slow is kept → slow's manifest and sample → the request is answered"""
    asked: queue.Queue[zenoh.Query] = queue.Queue()
    with (
        zenostat.connect(shared_node.endpoint, affinity="off") as bus,
        Peer(gateway) as peer,
        Peer(gateway, node="slow") as to,
    ):
        session, sample = bus.session, codec.encode(bus.latest("office"))
        manifest = codec.encode(bus.manifest("office").model_copy(update={"node": "slow"}))

        def answer(topic: keys.Topic, payload: bytes) -> Callback:
            encoding = zenoh.Encoding(codec.encoding(topic.reply))

            def on_query(query: zenoh.Query) -> None:
                with query:
                    query.reply(topic.at("slow"), payload, encoding=encoding)

            return Callback(on_query, indirect=False)

        denied = ErrorReply(error="RequestRejected", message="slow has heard it")
        manifests = session.declare_queryable(keys.MANIFEST.at("slow"), Callback(asked.put, indirect=False))
        samples = session.declare_queryable(keys.SAMPLE.at("slow"), answer(keys.SAMPLE, sample))
        rest = session.declare_queryable(keys.STATUS.at("slow"), answer(keys.STATUS, codec.encode(denied)))
        token = session.liveliness().declare_token(keys.NODE_TOKEN.at("slow", name="1"))
        query = asked.get(timeout=60)
        to.listen("")
        to.say("rpc/status")
        assert peer.ask("rpc/sing")[0] == "ErrorReply"
        assert to.ask("rpc/sing")[0] == "ErrorReply", "the gateway has taken both"
        assert to.silent()
        with query:
            query.reply(keys.MANIFEST.at("slow"), manifest, encoding=zenoh.Encoding(codec.encoding(Manifest)))
        assert to.hear(Manifest).node == "slow"
        assert to.hear(Sample).step == [0]
        assert to.answer()[1] == {"error": "RequestRejected", "message": "slow has heard it"}
        for one in (token, manifests, samples, rest):
            one.undeclare()
        assert to.event(EventKind.FAILED).error == "NodeLost"
        kind, gone = to.ask("rpc/status")
        assert (kind, gone["error"]) == ("ErrorReply", "NodeNotFound")
