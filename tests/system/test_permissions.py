"""Each cell of the table of permissions: a role, a topic, the own name and another's, over TLS with real certificates.

The node is a bare session with the node's rules, which receives whatever they let pass. What did not pass is known by a
fence: a query that every role may send, over the same link after it.
"""

import queue
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from support.nodes import free_port, until
from zenoh.handlers import Callback

from zenostat.bridge.transport.access_control import Permission, may
from zenostat.bridge.transport.session import open_session
from zenostat.topics import keys
from zenostat.topics.keys import TOPICS, Delivery, Role, Topic

ROLES = (Role.CONTROLLER, Role.OPERATOR, Role.MONITOR, Role.GATEWAY)
NOT_OWN = ("second", "{own}x", "x.{own}", "node", "*")
"""Names of others: a second controller's, those that only resemble one's own, the node's, and all names at once."""


class BareNode:
    """The session of a node; `received` has the keys of all puts, queries and tokens that pass its rules."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.received: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._declared: list[object] = []
        for topic in TOPICS:
            key = topic.everywhere("office")
            if topic.delivery is Delivery.TOKEN:
                subscriber = session.liveliness().declare_subscriber(key, self._note("show"))
                self._declared.append(subscriber)
                continue
            self._declared.append(session.declare_subscriber(key, self._note("send")))
            if topic.reply is not None:
                self._declared.append(session.declare_queryable(key, self._note("ask"), complete=True))

    def _note(self, action: str) -> Callback:
        def note(message: zenoh.Sample | zenoh.Query) -> None:
            key = str(message.key_expr)
            if isinstance(message, zenoh.Query):
                with message:
                    message.reply(key.replace("*", "office"), b"yes")
            elif message.kind != zenoh.SampleKind.PUT:
                return
            self.received.put((action, key))

        return Callback(note, indirect=False)

    def forget(self) -> None:
        """Forget what other tests have sent."""
        while not self.received.empty():
            self.received.get()

    def until(self, fence: str) -> set[tuple[str, str]]:
        """Return what has passed before a query on this key."""
        return set(iter(lambda: self.received.get(timeout=20), ("ask", fence)))


@pytest.fixture(scope="module")
def endpoint() -> str:
    return f"tls/127.0.0.1:{free_port()}"


@pytest.fixture(scope="module")
def node(pki: Path, endpoint: str) -> Iterator[BareNode]:
    with open_session(listen=[endpoint], keys=pki, role=Role.NODE) as session:
        yield BareNode(session)


def actions(topic: Topic) -> list[str]:
    if topic.delivery is Delivery.TOKEN:
        return ["show"]
    if topic.delivery is Delivery.QUERY:
        return ["ask"]
    return ["send", "ask"] if topic.reply else ["send"]


def attempt(session: zenoh.Session, action: str, key: str) -> object:
    if action == "send":
        return session.put(key, b"\x80")
    if action == "show":
        return session.liveliness().declare_token(key) if "*" not in key else None
    return list(session.get(key, payload=b"\x80", timeout=30))


def knows(session: zenoh.Session, node: BareNode) -> None:
    """Waits until the node's declarations have reached a client; those that its role may not use never do."""
    asked = session.declare_querier(keys.STATUS.at("office"))
    until(lambda: asked.matching_status.matching, "the client knows of the node")
    asked.undeclare()


@pytest.mark.parametrize("role", ROLES)
def test_permissions__what_a_role_sends_passes_under_its_own_name_alone(
    node: BareNode, pki: Path, endpoint: str, role: Role
) -> None:
    node.forget()
    own, others = role.value, [name.format(own=role.value) for name in NOT_OWN]
    with open_session(connect=[endpoint], keys=pki, role=role) as session:
        knows(session, node)
        expected, tokens = set(), []
        for topic in TOPICS:
            for action in actions(topic):
                senders = [own, f"{own}.part", *others] if topic.has_sender else [""]
                for sender in senders:
                    key = topic.at("office", name="one", sender=sender)
                    tokens.append(attempt(session, action, key))
                    if Permission(action) in may(role, topic) and (not sender or keys.is_own(own, sender)):
                        expected.add((action, key))
        fence = f"{keys.STATUS.at('*')}"
        attempt(session, "ask", fence)
        passed = node.until(fence)
        assert passed == expected
        del tokens


@pytest.mark.parametrize("role", ROLES)
def test_permissions__role_hears_and_sees_what_its_column_says(
    node: BareNode, pki: Path, endpoint: str, role: Role
) -> None:
    messages: queue.SimpleQueue[str] = queue.SimpleQueue()

    def note(message: zenoh.Sample) -> None:
        messages.put(str(message.key_expr))

    published = [topic for topic in TOPICS if topic.delivery in (Delivery.DROP, Delivery.BLOCK)]
    tokens = [topic for topic in TOPICS if topic.delivery is Delivery.TOKEN]
    with open_session(connect=[endpoint], keys=pki, role=role) as session:
        knows(session, node)
        for topic in published:
            session.declare_subscriber(topic.everywhere(), Callback(note, indirect=False))
        for topic in tokens:
            session.liveliness().declare_subscriber(topic.everywhere(), Callback(note, indirect=False))
        attempt(session, "ask", keys.STATUS.at("office"))  # the node has the subscriptions before it replies
        shown = []
        for topic in (*published, *tokens):
            key = topic.at("office", name="one", sender="second")
            shown.append(node.session.liveliness().declare_token(key) if topic in tokens else None)
            if topic not in tokens:
                node.session.put(key, b"x")
        node.session.put(keys.EVENT.at("fence"), b"x")
        received = set(iter(lambda: messages.get(timeout=20), keys.EVENT.at("fence")))
        for token in shown:
            if token is not None:
                token.undeclare()
    permitted = (Permission.HEAR, Permission.SEE)
    assert received == {
        topic.at("office", name="one", sender="second")
        for topic in (*published, *tokens)
        if any(permission in may(role, topic) for permission in permitted)
    }


@pytest.mark.parametrize("role", ROLES)
def test_permissions__nobody_but_a_node_answers(node: BareNode, pki: Path, endpoint: str, role: Role) -> None:
    with open_session(connect=[endpoint], keys=pki, role=role) as session:
        for topic in TOPICS:
            if topic.reply is not None:

                def answer(query: zenoh.Query) -> None:
                    with query:
                        query.reply(query.key_expr, b"forged")

                key = topic.everywhere("ghost")
                session.declare_queryable(key, Callback(answer, indirect=False), complete=True)
        attempt(session, "ask", keys.STATUS.at("office"))
        for topic in TOPICS:
            if topic.reply is not None:
                key = topic.at("ghost", name="one", sender=role.value)
                assert list(node.session.get(key, timeout=30)) == []


@pytest.mark.parametrize("name", ["trainer", "node"])
def test_permissions__name_with_two_roles_has_both_and_a_node_is_bound_to_no_name(
    node: BareNode, pki: Path, endpoint: str, name: str
) -> None:
    with open_session(
        connect=[endpoint], keys=pki, role=None if name == "trainer" else Role.NODE, certificate=name
    ) as session:
        knows(session, node)
        node.forget()
        for sender in (name, "second"):
            for topic in (keys.COMMAND, keys.ACTUATOR, keys.EVENT):
                attempt(session, "send", topic.at("office", name="one", sender=sender))
        fence = keys.SCENARIO.at("*")
        attempt(session, "ask", fence)
        passed = {key.removeprefix("zenostat/v3/office/") for _, key in node.until(fence)}
    own = {f"command/{name}", f"actuator/{name}/one"}
    assert passed == (own if name == "trainer" else own | {"command/second", "actuator/second/one", "event"})
