"""The contract's ways to subscribe: a program that reads nothing for a while is still answered."""

import queue
import re
from pathlib import Path

import pytest
import zenoh
from support.contract_page import PAGE

from zenostat.bridge.transport.session import open_session

UNREAD = 1000  # four times what Zenoh's default FIFO holds


@pytest.mark.parametrize("way", ["newest", "everything"])
def test_contract__unread_messages_hold_no_query_up(scratch: Path, way: str) -> None:
    section = PAGE.read_text(encoding="utf-8").partition("## How to subscribe")[2]
    code = re.search(r"```python\n(.*?)```", section, re.S)
    assert code is not None
    names: dict[str, object] = {}
    exec(code[1], names)  # the page's own program
    inbox: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    endpoint = f"unixsock-stream/{scratch}/bus"
    with open_session(listen=[endpoint]) as node, open_session(connect=[endpoint]) as client:
        node.declare_queryable("root/rpc/status", lambda query: query.reply("root/rpc/status", b"yes"))
        subscriber = names[way](client, "root", *([inbox] if way == "everything" else []))  # type: ignore[operator]
        assert [reply.ok is not None for reply in client.get("root/rpc/status", timeout=60)] == [True]
        for _ in range(UNREAD):
            node.put("root/sample", b"x", congestion_control=zenoh.CongestionControl.BLOCK)
        assert [reply.ok is not None for reply in client.get("root/rpc/status", timeout=60)] == [True]
        if way == "everything":
            assert [inbox.get(timeout=60).payload.to_bytes() for _ in range(UNREAD)] == [b"x"] * UNREAD
        subscriber.undeclare()
