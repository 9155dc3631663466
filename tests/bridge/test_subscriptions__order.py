"""The order in which a server's thread runs what others post."""

from pathlib import Path

import pytest

from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.transport.session import open_session


@pytest.mark.process
@pytest.mark.parametrize("before", range(10))
def test_first_task__of_a_task_is_next_wherever_the_turn_would_end(folder: Path, before: int) -> None:
    """Nothing comes between a reset and the start of its episodes."""
    done = list[str]()
    with open_session(listen=[f"unixsock-stream/{folder}/bus"]) as node, Subscriptions(node, "office") as subscriptions:
        for _ in range(before):
            subscriptions.post(lambda: done.append("write"))

        def reset() -> None:
            done.append("reset")
            subscriptions.post_first(lambda: done.append("start"))

        subscriptions.post(reset)
        for _ in range(10):
            subscriptions.post(lambda: done.append("write"))
        while "reset" not in done:
            subscriptions.receive(wait=False)
            subscriptions.run_pending()
        assert done[done.index("reset") + 1] == "start"
