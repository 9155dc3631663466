"""A browser, and one in which an operator has signed in to the module's control room."""

from collections.abc import Iterator
from typing import Any

import pytest
from support.control_room import Visitor, chromium


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
