"""Names that only one gateway of a node can have, on an in-process bus with and without certificates."""

import asyncio
from pathlib import Path

import pytest
import zenoh
from support.certificates import house_keys
from support.nodes import free_port, until

from zenostat.bridge.transport.certificates import add
from zenostat.bridge.transport.session import open_session
from zenostat.gateways.exclusive_names import liveliness_tokens, reserved_names
from zenostat.topics import keys
from zenostat.topics.errors import NameInUse
from zenostat.topics.keys import Role

NAMES = {"panel": "choose another name with --source"}


async def tokens_of(session: zenoh.Session, count: int) -> list[str]:
    """Return the keys of the gateways' tokens, once there are that many."""
    while len(tokens := await liveliness_tokens(session, keys.GATEWAY_TOKEN.everywhere("office"))) != count:
        await asyncio.sleep(0.01)
    return tokens


async def test_reserved_names__second_gateway_is_refused_with_the_certificate_of_the_first(tmp_path: Path) -> None:
    folder, endpoint = house_keys(tmp_path / "keys"), f"tls/127.0.0.1:{free_port()}"
    add(folder, Role.GATEWAY, "mqtt")
    with (
        open_session(listen=[endpoint], keys=folder, role=Role.NODE),
        open_session(connect=[endpoint], keys=folder, certificate="mqtt") as first,
        open_session(connect=[endpoint], keys=folder, certificate="gateway") as second,
    ):
        async with reserved_names(first, "office", NAMES, "mqtt"):
            (token,) = await tokens_of(second, 1)
            assert keys.GATEWAY_TOKEN.names_in(token)[0] == "mqtt"
            with pytest.raises(NameInUse, match=r"uses 'panel' already \(mqtt, process \d+ on .*\); choose another"):
                async with reserved_names(second, "office", NAMES, "gateway"):
                    pass
        await tokens_of(second, 0)
        async with reserved_names(second, "office", NAMES, "gateway"):
            pass


async def test_reserved_names__token_of_another_form_is_ignored(folder: Path) -> None:
    endpoint = f"unixsock-stream/{folder}/bus"
    with open_session(listen=[endpoint]) as session, open_session(connect=[endpoint]) as stranger:
        odd = [
            stranger.liveliness().declare_token(keys.GATEWAY_TOKEN.at("office", sender="x", name=name))
            for name in ("panel", "a:b", "panel:1:2:3:4")
        ]
        seen = keys.GATEWAY_TOKEN.everywhere("office")
        until(lambda: len(list(session.liveliness().get(seen))) == len(odd), "they are visible")
        async with reserved_names(session, "office", NAMES):
            pass
