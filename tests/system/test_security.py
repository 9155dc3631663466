"""A closed door: real certificates, real nodes, and programs that try what they may not.

What did not happen is known by a fence: something allowed, sent over the same link after what is not. When its effect
is there, whatever went before it has been dropped.
"""

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import zenoh
from support import security_page
from support.certificates import expire
from support.nodes import SMALL, NodeProgram, free_port, until
from support.run_cli import run_program
from zenoh.handlers import FifoChannel

import zenostat
from zenostat import Bus, ControllerLink
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.transport.access_control import ALL_MESSAGES, Permission, acl_config, may, name_rules, rules
from zenostat.bridge.transport.certificates import add, make
from zenostat.bridge.transport.identity import identity
from zenostat.bridge.transport.name_list import CERTIFIED
from zenostat.bridge.transport.session import check_endpoint, exposure, open_session
from zenostat.bridge.transport.tls_diagnosis import diagnose_tls
from zenostat.cosim.node_plant import FoundPlant
from zenostat.topics import codec, keys
from zenostat.topics.errors import AddressInUse, InvalidConfig, NodeNotFound, UsageError
from zenostat.topics.keys import TOPICS, Role
from zenostat.topics.messages import Ack, Claim, Command, Event, EventKind, Reset, State, Stop, Write

POINT = "core_zn_cooling_setpoint"
FORGED = b"forged"
_numbers = count()


@pytest.fixture(scope="module")
def strange_pki(module_folder: Path) -> Path:
    """The keys of another house."""
    make(module_folder / "strange")
    return module_folder / "strange"


@pytest.fixture(scope="module")
def node(module_folder: Path, pki: Path) -> Iterator[NodeProgram]:
    """A node named `office` behind a closed door, which these tests share."""
    listen = [f"tls/127.0.0.1:{free_port()}"]
    with NodeProgram(module_folder / "node", **SMALL, listen=listen, keys=str(pki)) as running:
        yield running


@pytest.fixture
def watcher(node: NodeProgram, pki: Path) -> Iterator[Bus]:
    with zenostat.connect(node.endpoint, keys=pki, role=Role.MONITOR, affinity="off") as connected:
        yield connected


def raw(endpoint: str, folder: Path, name: str | None, *, authority: Path | None = None, mode: str = "client") -> Any:
    """A session of somebody who keeps to no rules of ours: any certificate, any mode."""
    tls: dict[str, Any] = {
        "root_ca_certificate": str((authority or folder) / "ca.pem"),
        "enable_mtls": name is not None,
    }
    if name is not None:
        tls |= {"connect_certificate": str(folder / f"{name}.pem"), "connect_private_key": str(folder / f"{name}.key")}
    settings = {
        "mode": mode,
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 2000,
        "connect/exit_on_failure": True,
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
        "transport/link/tls": tls,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


@contextmanager
def hearing(session: zenoh.Session, key: str) -> Iterator[zenoh.Subscriber]:
    with session.declare_subscriber(key, FifoChannel(4096)) as subscriber:
        yield subscriber
        while subscriber.try_recv() is not None:
            pass


def before_fence(
    bus: Bus, inbox: zenoh.Subscriber, session: zenoh.Session | None = None, name: str = "trainer"
) -> list[bytes]:
    """Return what `inbox` received until the event of a claim of nothing by `session`, whose certificate has a name."""
    source = f"{name}.fence-{next(_numbers)}"
    claim = Claim(controller=source, actuators=[], required=False)
    assert ask(session or bus.session, keys.CLAIM, claim, sender=source)
    payloads: list[bytes] = []
    while True:
        message = inbox.recv()
        payload = message.payload.to_bytes()
        is_event = str(message.key_expr) == keys.EVENT.at("office") and payload != FORGED
        if is_event and codec.decode(Event, payload).source == source:
            return payloads
        payloads.append(payload)


def ask(
    session: zenoh.Session, topic: keys.Topic, question: Any = None, name: str = "", sender: str = ""
) -> list[bytes]:
    payload = codec.encode(question) if question else None
    replies = session.get(topic.at("office", name=name, sender=sender), payload=payload, timeout=30)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok]


# The rules, without Zenoh

SEND, HEAR, ASK, SHOW, SEE = Permission.SEND, Permission.HEAR, Permission.ASK, Permission.SHOW, Permission.SEE
CONTROLS, OPERATES = {Role.CONTROLLER, Role.GATEWAY}, {Role.OPERATOR, Role.GATEWAY}
SENDERS = {  # topic: roles that send it, or query, under their own names
    "command/{sender}": CONTROLS,
    "actuator/{sender}/{name}": OPERATES,
    "rpc/claim/{sender}": CONTROLS,
    "rpc/command/{sender}": CONTROLS,
    "rpc/write/{sender}/{name}": OPERATES,
    "rpc/reset/{sender}": OPERATES,
    "rpc/pace/{sender}": OPERATES,
    "rpc/faults/{sender}": OPERATES,
    "rpc/record/{sender}": OPERATES,
    "rpc/acknowledge/{sender}": OPERATES,
    "rpc/stop/{sender}": CONTROLS | OPERATES,  # controllers end their branches
    "rpc/snapshot/{sender}": CONTROLS,
    "rpc/drop/{sender}": CONTROLS | OPERATES,  # controllers drop their own snapshots
    "rpc/branch/{sender}": CONTROLS,
    "rpc/plan/{sender}": CONTROLS,
    "rpc/try/{sender}": CONTROLS,
    "@live/controller/{sender}": CONTROLS,
    "@live/gateway/{sender}/{name}": {Role.GATEWAY},
    "@live/node/{name}": set(),
}
CLIENTS = tuple(role for role in CERTIFIED if role is not Role.NODE)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.key)
def test_security__what_a_role_may_do(topic: keys.Topic) -> None:
    senders = SENDERS.get(topic.key, OPERATES if topic.has_sender else set())
    for role in CLIENTS:
        permitted = set(may(role, topic))
        assert permitted <= {HEAR, ASK, SEE} if role not in senders else permitted & {SEND, ASK, SHOW}
        if topic.has_sender and role not in senders:
            assert permitted <= {SEE}
        if topic.sender is Role.ANYONE:
            assert permitted == {ASK}
        if topic.sender is Role.NODE and topic.delivery is not keys.Delivery.TOKEN:
            assert permitted == ({HEAR, ASK} if topic.reply else {HEAR})


def test_security__page_has_the_table_of_permissions() -> None:
    text = security_page.PAGE.read_text(encoding="utf-8")
    assert security_page.BEGIN in text
    assert security_page.page(text) == text, "python tests/support/security_page.py writes it again"


def test_security__monitor_only_reads_and_nobody_but_a_node_answers() -> None:
    incoming = {
        role: {
            message
            for rule in (*rules(role), *(name_rules("x", [role]) if role is not Role.NODE else ()))
            if rule.flow == "ingress"
            for message in rule.messages
        }
        for role in CERTIFIED
    }
    aggregation = {"declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"}
    assert incoming[Role.MONITOR] == aggregation
    assert incoming[Role.OPERATOR] == aggregation | {"put"}
    assert incoming[Role.CONTROLLER] == incoming[Role.GATEWAY] == aggregation | {"put", "liveliness_token"}
    assert incoming[Role.NODE] == set(ALL_MESSAGES)


def test_security__no_key_lies_outside_of_the_table() -> None:
    allowed = {str(zenoh.KeyExpr(topic.everywhere())) for topic in TOPICS} | {keys.stream("*")}
    assert {key for role in CERTIFIED for rule in rules(role) for key in rule.keys} <= allowed
    for rule in name_rules("ppo-7", CLIENTS):
        for key in rule.keys:
            assert "/ppo-7/" in f"{key}/" or "/ppo-7.$*/" in f"{key}/"
            assert any(zenoh.KeyExpr(other).includes(zenoh.KeyExpr(key)) for other in allowed)


def test_security__zenoh_denies_what_no_rule_allows() -> None:
    names = {"office": (Role.NODE,), "ppo-7": (Role.CONTROLLER,), "panel": (Role.OPERATOR, Role.CONTROLLER)}
    config = acl_config(names)
    assert (config["enabled"], config["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in config["rules"]} == {"allow"}
    assert {one["id"]: one["cert_common_names"] for one in config["subjects"]} == {name: [name] for name in names}
    assert all(policy["subjects"] and policy["rules"] for policy in config["policies"])
    assert len({rule["id"] for rule in config["rules"]}) == len(config["rules"])


# What may be done


def day(link: ControllerLink, meanwhile: Any = lambda _: None) -> list[bytes]:
    """A day at 25 degC, in lockstep; all values of all samples."""
    sample, values = link.reset(), []
    while True:
        values.append(sample.message.values)
        meanwhile(sample)
        if sample.truncated:
            return values
        sample.send({POINT: 25.0})
        sample = link.receive()


@pytest.mark.slow
def test_security__monitor_s_attacks_leave_the_day_as_it_is(
    node: NodeProgram, pki: Path, bus: Bus, watcher: Bus
) -> None:
    """A controller with a good certificate runs a day in lockstep, then the same day under a monitor's attacks."""
    with bus.controller("office") as link, raw(node.endpoint, pki, "monitor") as attacker:
        quiet = day(link)
        assert len(quiet) == 97
        replies: list[bytes] = []

        def attack(sample: SampleView) -> None:
            extreme = np.full(len(link.manifest.actuators), 22.5).astype("<f8").tobytes()
            command = Command(episode=sample.message.episode, step=sample.message.step, values=extreme)
            for sender in (link.name, "monitor"):
                at = {"name": POINT, "sender": sender}
                attacker.put(keys.COMMAND.at("office", sender=sender), codec.encode(command))
                attacker.put(keys.ACTUATOR.at("office", **at), codec.encode(Write(value=29.0, priority=1)))
                attacker.delete(keys.ACTUATOR.at("office", **at))
                if sample.step % 24 == 0:
                    replies.extend(ask(attacker, keys.CLAIM, Claim(controller=sender, priority=1), sender=sender))
                    replies.extend(ask(attacker, keys.RESET, Reset(controller=sender), sender=sender))
                    replies.extend(ask(attacker, keys.STOP, Stop(source=sender), sender=sender))
                    replies.extend(ask(attacker, keys.WRITE_REQUEST, Write(value=29.0, priority=1), **at))
                    replies.extend(ask(attacker, keys.COMMAND_REQUEST, command, sender=sender))
            assert ask(attacker, keys.STATUS), "the attacker is there, and what it sent before has been dropped"

        before = watcher.status("office")
        with hearing(watcher.session, keys.EVENT.at("office")) as events:
            assert ask(watcher.session, keys.STATUS), "the node knows of the subscription"
            assert day(link, attack) == quiet
            received = [codec.decode(Event, payload) for payload in before_fence(bus, events)]
        after = bus.status("office")
        assert replies == []
        assert (after.rejected, after.late, after.duplicate) == (before.rejected, before.late, before.duplicate)
        assert {event.kind for event in received} == {EventKind.STARTED, EventKind.ENDED}
        controllers = [c.controller for c in after.controllers if c.state.is_connected]
        assert [name for name in controllers if ".fence-" not in name] == [link.name]


@pytest.mark.slow
def test_security__same_attacks_work_under_the_own_name_of_an_operator_who_controls(
    node: NodeProgram, pki: Path, bus: Bus
) -> None:
    with raw(node.endpoint, pki, "trainer") as session, hearing(bus.session, keys.EVENT.at("office")) as events:
        assert ask(bus.session, keys.STATUS), "the node knows of the subscription"
        own = "trainer.thief"
        claim = Claim(controller=own, priority=1, required=False)
        codec.decode(Ack, ask(session, keys.CLAIM, claim, sender=own)[0])
        episode = codec.decode(Ack, ask(session, keys.RESET, Reset(controller=own), sender=own)[0]).episode
        session.put(keys.ACTUATOR.at("office", name=POINT, sender=own), codec.encode(Write(value=29.0)))
        codec.decode(Ack, ask(session, keys.WRITE_REQUEST, Write(value=28.0, source=own), POINT, own)[0])
        session.put(keys.COMMAND.at("office", sender=own), b"not msgpack")
        received = [codec.decode(Event, payload) for payload in before_fence(bus, events, session)]
        assert EventKind.WRITTEN in {event.kind for event in received if event.source == own}
        while EventKind.REJECTED not in {event.kind for event in received}:  # commands have a way of their own
            received.append(codec.decode(Event, events.recv().payload.to_bytes()))
        assert bus.status("office").episode == episode


@pytest.mark.slow
def test_security__programs_that_reset_connect_with_the_trainer_s_certificate(node: NodeProgram, pki: Path) -> None:
    plant = FoundPlant("office", node.endpoint, pki)
    try:
        assert plant.reset(3).values.shape == (1, len(plant.manifest.names))
    finally:
        plant.close()
    bus_options = ("--connect", node.endpoint, "--keys", str(pki))
    done = run_program("run", "--node", "office", "--controller", "rbc", "--reset", "--seed", "3", *bus_options)
    assert done.returncode == 0, done.stderr
    certificate = ("--certificate", "controller")
    done = run_program("run", "--node", "office", "--controller", "rbc", "--reset", *bus_options, *certificate)
    assert done.returncode == 2
    assert "controller.pem is of the role controller; controller and operator expected" in done.stderr


@pytest.mark.parametrize("name", ["controller", "operator", "monitor"])
def test_security__environment_or_district_that_may_not_reset_claims_nothing(
    node: NodeProgram, pki: Path, watcher: Bus, name: str
) -> None:
    """A claim of theirs would keep the node waiting."""
    before = watcher.status("office").controllers
    message = rf"{name}\.pem is of the role {name}; controller and operator expected, as trainer\.pem has"
    for make_one in (
        lambda keys: gym.make("zenostat/Building-v1", connect=node.endpoint, node="office", keys=keys),
        lambda keys: gym.make_vec(
            "zenostat/Building-v1", num_envs=1, connect=[node.endpoint], node=["office"], keys=keys
        ),
        lambda keys: FoundPlant("office", node.endpoint, keys),
    ):
        with pytest.raises(InvalidConfig, match=message):
            make_one(pki / f"{name}.pem")
    assert watcher.status("office").controllers == before


@pytest.mark.slow
def test_security__operator_may_stop_a_node_and_a_monitor_not(scratch: Path, pki: Path) -> None:
    listen = [f"tls/127.0.0.1:{free_port()}"]
    with NodeProgram(scratch / "own", **SMALL, listen=listen, keys=str(pki), name="own") as running:
        with zenostat.connect(listen[0], keys=pki, role=Role.MONITOR, affinity="off") as watching:
            with pytest.raises(InvalidConfig, match="monitor 'monitor' may not query rpc/stop"):
                watching.stop("own")
            with pytest.raises(InvalidConfig, match=r"may not query rpc/claim.* that also has the role controller"):
                watching.controller("own")
            assert watching.status("own").state is State.WAITING
        with zenostat.connect(listen[0], keys=pki, role=Role.OPERATOR, affinity="off") as operating:
            operating.stop("own")
        assert running.process.wait() == 0


def test_security__monitor_reads(watcher: Bus, bus: Bus) -> None:
    assert watcher.nodes() == ["office"]
    assert watcher.scenario("office") == bus.scenario("office")
    assert watcher.weather("office", ["dry_bulb_temperature"]).units == ["C"]
    with watcher.listen("office") as samples, bus.controller("office", name="shown") as link:
        sample = link.reset()
        until(lambda: watcher.controllers() == [("office", link.name)], "the controller is there")
        view = next(samples)
        assert (view.step, view.message.values) == (0, sample.message.values)
        assert watcher.latest("office") == sample.message


def test_security__monitor_hears_no_commands(node: NodeProgram, pki: Path, bus: Bus) -> None:
    """Nor does another controller; a node, which passes them on, does."""
    counts: dict[str, int] = {}
    for name in ("monitor", "second", "node"):
        with raw(node.endpoint, pki, name) as session, bus.controller("office") as link:
            link.reset()
            with (
                hearing(session, keys.COMMAND.everywhere("office")) as commands,
                session.declare_subscriber(keys.SAMPLE.at("office"), FifoChannel(16)) as samples,
            ):
                assert ask(session, keys.STATUS), "the node knows of the subscriptions"
                link.send()
                link.receive()
                samples.recv()
                link.send()
                link.receive()
                samples.recv()
                counts[name] = len(list(iter(commands.try_recv, None)))
    assert counts["monitor"] == counts["second"] == 0
    assert counts["node"] >= 1


# Posing as a node


@pytest.mark.parametrize(
    ("name", "mode", "passes"),
    [
        ("controller", "client", False),
        ("controller", "peer", False),
        ("controller", "router", False),
        ("node", "client", True),
    ],
)
def test_security__nobody_hears_what_a_controller_states_in_a_node_s_name(
    node: NodeProgram, pki: Path, bus: Bus, watcher: Bus, name: str, mode: str, passes: bool
) -> None:
    stream, point = keys.stream("office"), keys.SENSOR.at("office", name="core_zn_air_temperature")
    with (
        raw(node.endpoint, pki, name, mode=mode) as forger,
        hearing(watcher.session, stream) as inbox,
        hearing(watcher.session, point) as points,
    ):
        assert ask(watcher.session, keys.STATUS), "the node knows of the subscriptions"
        for topic in (keys.SAMPLE, keys.EVENT, keys.MANIFEST):
            forger.put(topic.at("office"), FORGED, priority=zenoh.Priority.INTERACTIVE_HIGH)  # that of the fence
        forger.put(point, FORGED, priority=zenoh.Priority.INTERACTIVE_HIGH)
        payloads = before_fence(bus, inbox, forger, name)
        assert payloads.count(FORGED) == (3 if passes else 0)
        assert (points.try_recv() is not None) == passes
    assert watcher.manifest("office").node == "office"


@pytest.mark.parametrize(("name", "passes"), [("controller", False), ("node", True)])
def test_security__forged_presence_is_not_seen(
    node: NodeProgram, pki: Path, watcher: Bus, name: str, passes: bool
) -> None:
    last = "f" * 32  # instances below the node's own would end it in its first seconds
    with raw(node.endpoint, pki, name) as forger:
        tokens = [
            forger.liveliness().declare_token(key)
            for key in (
                keys.NODE_TOKEN.at("ghost", name=last),
                keys.NODE_TOKEN.at("office", name=last),
                keys.CONTROLLER_TOKEN.at("office", sender="second" if name == "controller" else "ghost"),
                keys.CONTROLLER_TOKEN.at("office", sender=f"{name}.fence"),
            )
        ]
        assert ask(forger, keys.STATUS)
        controllers = {controller for _, controller in watcher.controllers()}
        assert f"{name}.fence" in controllers
        assert not controllers & {"second"}
        seen = watcher.session.liveliness().get(keys.NODE_TOKEN.at("*", name="*"))
        instances = {(keys.node_of(key), keys.last_chunk(key)) for key in (str(reply.ok.key_expr) for reply in seen)}
        forged = {("ghost", last), ("office", last)}
        assert instances & forged == (forged if passes else set())
        assert len(instances - forged) == 1
        for token in tokens:
            token.undeclare()


@pytest.mark.parametrize(("name", "passes"), [("controller", False), ("monitor", False), ("node", True)])
def test_security__only_a_node_answers_requests(
    node: NodeProgram, pki: Path, watcher: Bus, bus: Bus, name: str, passes: bool
) -> None:
    def on_query(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, FORGED)

    key = keys.SCENARIO.at("ghost")
    with raw(node.endpoint, pki, name) as forger, forger.declare_queryable(key, on_query, complete=True):
        assert ask(forger, keys.STATUS)
        for asking in (watcher, bus):
            answers = [reply.ok.payload.to_bytes() for reply in asking.session.get(key, timeout=30) if reply.ok]
            assert answers == ([FORGED] if passes else [])


@pytest.mark.slow
def test_security__controller_s_certificate_cannot_be_listened_with(pki: Path) -> None:
    """Whoever stands in a node's place needs a node's certificate: the others are none of a TLS server."""
    endpoint = f"tls/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5(
        "transport/link/tls",
        json.dumps(
            {
                "root_ca_certificate": str(pki / "ca.pem"),
                "listen_certificate": str(pki / "controller.pem"),
                "listen_private_key": str(pki / "controller.key"),
            }
        ),
    )
    with zenoh.open(config), pytest.raises(NodeNotFound, match="refused: unsuitable certificate purpose"):
        open_session(connect=[endpoint], keys=pki, role=Role.MONITOR)


# Strangers


def strangers() -> list[Any]:
    return [
        pytest.param(None, False, id="without a certificate"),
        pytest.param("controller", True, id="with another authority's"),
        pytest.param("node", True, id="with a node's of another authority"),
    ]


@pytest.mark.variants
@pytest.mark.parametrize(("name", "strange"), strangers())
def test_security__stranger_cannot_connect(
    node: NodeProgram, pki: Path, strange_pki: Path, name: str | None, strange: bool
) -> None:
    """It trusts the node, whose authority's certificate is no secret; the node does not trust it."""
    with pytest.raises(zenoh.ZError, match="Unable to connect"):
        raw(node.endpoint, strange_pki if strange else pki, name, authority=pki)
    with raw(node.endpoint, pki, "monitor", authority=pki) as friend:
        assert ask(friend, keys.STATUS)


@pytest.mark.slow
def test_security__without_tls_nobody_gets_in(node: NodeProgram) -> None:
    with pytest.raises(NodeNotFound):
        open_session(connect=[node.endpoint.replace("tls/", "tcp/")])


@pytest.mark.slow
def test_security__expired_certificate_is_refused_by_the_node_and_before(
    node: NodeProgram, pki: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expire(pki, "late", monkeypatch)
    with pytest.raises(zenoh.ZError, match="Unable to connect"):
        raw(node.endpoint, pki, "late")
    with pytest.raises(InvalidConfig, match="expired on"):
        zenostat.connect(node.endpoint, keys=pki, certificate="late")
    with zenostat.connect(node.endpoint, keys=pki, certificate="second", affinity="off") as connected:
        assert connected.nodes() == ["office"]


# What the errors say


@pytest.mark.slow
def test_security__why_there_is_no_session(node: NodeProgram, pki: Path, strange_pki: Path, tmp_path: Path) -> None:
    def refusal(endpoint: str, folder: Path) -> str:
        with pytest.raises(NodeNotFound) as raised:
            open_session(connect=[endpoint], keys=folder, role=Role.CONTROLLER)
        return str(raised.value)

    assert "is it a node's of the authority" in refusal(node.endpoint, strange_pki)
    free = f"tls/127.0.0.1:{free_port()}"
    assert f"nobody listens on {free}" in refusal(free, pki)
    mixed = tmp_path / "mixed"  # it trusts the node's authority, and shows another's certificate
    make(mixed)
    (mixed / "ca.pem").write_bytes((pki / "ca.pem").read_bytes())
    with pytest.raises(InvalidConfig, match="of another authority"):
        open_session(connect=[node.endpoint], keys=mixed, role=Role.CONTROLLER)


@pytest.mark.slow
def test_diagnose_tls__reports_a_refusal_by_the_peer(node: NodeProgram, pki: Path, strange_pki: Path) -> None:
    shown = replace(identity(strange_pki, Role.CONTROLLER), authority=pki / "ca.pem")
    assert f"{node.endpoint} refused the session over TLS: " in diagnose_tls(node.endpoint, shown)
    good = identity(pki, Role.CONTROLLER)
    assert "refused" not in diagnose_tls(node.endpoint, good)


@pytest.mark.slow
def test_security__node_is_reached_under_the_names_in_its_certificate(pki: Path) -> None:
    def listening(certificate: str | None) -> Any:
        return open_session(listen=[endpoint], keys=pki, role=Role.NODE, certificate=certificate)

    endpoint = f"tls/127.0.0.2:{free_port()}"
    with listening(None), pytest.raises(NodeNotFound, match=r"mismatch.*'127\.0\.0\.2' among its hosts"):
        open_session(connect=[endpoint], keys=pki, role=Role.MONITOR)
    add(pki, Role.NODE, "annex", hosts=["127.0.0.2"])
    with listening("annex"), open_session(connect=[endpoint], keys=pki, role=Role.MONITOR) as session:
        assert len(list(session.info.peers_zid())) == 1


def test_security__taken_port(node: NodeProgram, pki: Path) -> None:
    with pytest.raises(AddressInUse):
        open_session(listen=[node.endpoint], keys=pki, role=Role.NODE)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"connect": ["tcp/127.0.0.1:1"], "role": Role.NODE}, "tcp/127.0.0.1:1 takes no keys.*write tls/127.0.0.1:1"),
        ({"listen": ["unixsock-stream/x"], "role": Role.NODE}, "takes no keys, only TLS"),
        ({"connect": ["tls/127.0.0.1:1"]}, "keys need a role: node, controller, operator, monitor, gateway"),
        ({"connect": ["tls/127.0.0.1:1"], "role": Role.ANYONE}, "keys need a role"),
        ({"listen": ["tls/127.0.0.1:1"], "role": Role.CONTROLLER}, "a controller does not listen"),
        ({"listen": ["tls/0.0.0.0:1"], "role": Role.NODE}, r"tls/0\.0\.0\.0:1 can be reached.*--expose"),
        ({"connect": ["tls/127.0.0.1:1"], "role": Role.NODE, "certificate": "x"}, "no certificate 'x'"),
        ({"role": Role.NODE}, "name an endpoint"),
    ],
)
def test_security__settings_that_cannot_be(pki: Path, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        open_session(keys=pki, **settings)


def test_open_session__reports_all_errors_at_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as raised:
        open_session(listen=["tcp/0.0.0.0:1"], connect=["here"], keys=tmp_path / "none", role=Role.NODE)
    for fault in ("'here' is not an endpoint", "write tls/0.0.0.0:1", "--expose", "zenostat keys init"):
        assert fault in str(raised.value)


def test_security__tls_without_keys() -> None:
    with pytest.raises(InvalidConfig, match=r"tls/127\.0\.0\.1:1 needs keys: zenostat keys init"):
        open_session(connect=["tls/127.0.0.1:1"])
    with pytest.raises(InvalidConfig, match="needs the folder of its keys"):
        open_session(connect=["tcp/127.0.0.1:1"], certificate="x")


@pytest.mark.parametrize("endpoint", ["tls/", "tls/host", "tls/host:1#enable_mtls=false", "tls/a b:1", "quic/h:1"])
def test_security__what_is_no_tls_endpoint(endpoint: str) -> None:
    with pytest.raises(InvalidConfig, match=r"tls/HOST:PORT"):
        check_endpoint(endpoint)


def test_security__listening_to_all_without_keys_is_warned_of(pki: Path) -> None:
    assert "zenostat keys init" in exposure(["tcp/0.0.0.0:7447"], None)
    assert exposure(["tls/0.0.0.0:7447"], pki) == exposure(["tcp/127.0.0.1:7447"], None) == ""
    assert exposure(["unixsock-stream/x"], None) == ""


# The commands


@pytest.mark.slow
def test_security__commands_take_keys(node: NodeProgram, pki: Path) -> None:
    def run_zenostat(*arguments: str) -> subprocess.CompletedProcess[str]:
        return run_program(*arguments, "--connect", node.endpoint, "--keys", str(pki))

    ran = run_zenostat("run", "--node", "office", "--controller", "rbc", "--reset", "--certificate", "trainer")
    assert ran.returncode == 0, ran.stderr
    status = run_zenostat("status")
    assert status.returncode == 0, status.stderr
    assert "step 96 of 96" in status.stdout
    refused = run_zenostat("run", "--node", "office", "--certificate", "monitor")
    assert refused.returncode == 2
    assert "is of the role monitor; controller expected" in refused.stderr


def test_security__environment_joins_over_tls_with_keys_alone(node: NodeProgram, pki: Path) -> None:
    env = gym.make("zenostat/Building-v1", connect=node.endpoint, node=node.name, keys=pki)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.observation_space.contains(env.step(env.action_space.sample())[0])
    env.close()
    with pytest.raises(InvalidConfig, match="keys"):
        gym.make("zenostat/Building-v1", connect=node.endpoint, node=node.name)
    with pytest.raises(InvalidConfig, match="connect"):
        gym.make("zenostat/Building-v1", building="office-small", weather="USA_CO_Denver", keys=pki)
