"""Keys of a control room, a browser, and one in which an operator has signed in to the module's control room."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.clock import Clock
from support.control_room import Visitor, chromium

from zenostat.bridge.transport import certificates
from zenostat.topics.keys import Role


@pytest.fixture(scope="module")
def keys(module_folder: Path) -> Path:
    """Keys of a bus with two operators, a monitor, and a certificate of the page."""
    folder = module_folder / "keys"
    certificates.make(folder)
    for role, name in ((Role.OPERATOR, "ada"), (Role.OPERATOR, "eve"), (Role.MONITOR, "wall")):
        certificates.add(folder, role, name)
    certificates.add(folder, Role.NODE, "room", hosts=["room.example.org"])
    return folder


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def signed_in(browser: Any, room: Any) -> Iterator[Visitor]:
    """A browser that has signed in as Ada."""
    visitor = Visitor(browser)
    visitor.open(room.link).locator(".card").wait_for()
    yield visitor
    visitor.close()


@pytest.fixture(scope="module")
def ada(signed_in: Visitor, room: Any) -> Iterator[Visitor]:
    """A browser that has signed in as Ada; in the end nothing may have complained, or asked another host."""
    yield signed_in
    assert signed_in.complaints == []
    assert signed_in.hosts == {room.url.removeprefix("http://")}
