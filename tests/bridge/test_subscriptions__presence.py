"""Controllers that claim without a liveliness token, whose end nothing would tell, are taken for disconnected."""

from pathlib import Path

import pytest
from support.nodes import until

from zenostat.bridge.node import controller_presence
from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.runtime.timer import Timer
from zenostat.bridge.transport.session import open_session
from zenostat.topics import keys


@pytest.mark.process
def test_subscriptions__sender_without_a_token_is_disconnected(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller_presence, "_TOKEN_S", 0.2)
    endpoint, disconnected, reconnected = f"unixsock-stream/{folder}/bus", list[str](), list[str]()
    with (
        open_session(listen=[endpoint]) as node,
        open_session(connect=[endpoint]) as client,
        client.liveliness().declare_token(keys.CONTROLLER_TOKEN.at("office", sender="former")),
        Subscriptions(node, "office") as own,
        Timer() as timer,
    ):
        own.watch_presence(disconnected.append, reconnected.append)
        with client.liveliness().declare_token(keys.CONTROLLER_TOKEN.at("office", sender="late")):
            for name in ("former", "late", "ghost"):  # the token of the first one is older than the node's subscription
                own.expect_presence(name, timer)
            until(lambda: own.run_pending() or disconnected, "the one without a token is disconnected")
            assert disconnected == ["ghost"]
        until(lambda: own.run_pending() or len(disconnected) == 2, "a token ends")
        assert disconnected == ["ghost", "late"]
        assert sorted(reconnected) == ["former", "late"]
