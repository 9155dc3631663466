"""The control room of a bus in this process, and browsers that open it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

import zenostat
from support.http_servers import running
from zenostat.bridge.runtime.affinity import Affinity

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
NEEDS_CHROMIUM = pytest.mark.skipif(
    CHROMIUM is None, reason="the system has no Chromium; on Debian: apt install chromium"
)
ARGUMENTS = (
    "--no-sandbox",
    "--headless",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@contextmanager
def control_room(endpoint: str, *, keys: Any = None, role: Any = None, **settings: Any) -> Iterator[Any]:
    """A server of the control room on a free port, in a thread; on a bus with `keys` in a role."""
    from zenostat.views.room.server import RoomServer

    settings = {"operator": "ada", **settings}
    with (
        zenostat.connect(endpoint, affinity=Affinity.OFF, wait=True, keys=keys, role=role) as bus,
        RoomServer(bus, "127.0.0.1:0", **settings) as server,
        running(server),
    ):
        yield server


def write_training(folder: Path, scenario: str = "tank") -> None:
    """A training of half its steps, evaluated twice in two episodes."""
    folder.mkdir(parents=True)
    (folder / "training.yaml").write_text(f"algorithm: ppo\nscenario: {json.dumps(scenario)}\nsteps: 400\nseed: 3\n")
    (folder / "versions.json").write_text('{"format": 1}')
    (folder / "evaluations.csv").write_text("step,seed,reward\n100,1,-4\n100,2,-5\n200,1,-2\n200,2,-3\n")


@contextmanager
def chromium() -> Iterator[Any]:
    """The system's Chromium, driven by playwright."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS])
        try:
            yield browser
        finally:
            browser.close()


class Visitor:
    """A browser of its own cookies; what it complains about, and which hosts it asks.

    Attributes:
        page: its page.
        complaints: messages of its console, and errors of scripts.
        hosts: hosts and ports of all requests.
    """

    def __init__(self, browser: Any, *, width: int = 1280, scheme: str = "dark") -> None:
        self._context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        self._context.set_default_timeout(60_000)
        self.page = self._context.new_page()
        self.complaints: list[str] = []
        self.hosts: set[str] = set()
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.hosts.add(urlsplit(request.url).netloc))

    def open(self, url: str) -> Any:
        """Open an address, and return the page."""
        self.page.goto("about:blank")
        self.page.goto(url)
        return self.page

    def close(self) -> None:
        self._context.close()


def violations(page: Any, *, exclude: tuple[str, ...] = ()) -> list[str]:
    """Violations that axe-core reports by its default rules: rule, element and reason of each."""
    from axe_playwright_python.sync_playwright import Axe

    context = {"exclude": [[selector] for selector in exclude]} if exclude else None
    result = Axe().run(page, context, {"resultTypes": ["violations"]}).response["violations"]
    return [
        f"{rule['id']}: {node['html'][:160]}: {node['failureSummary']}" for rule in result for node in rule["nodes"][:4]
    ]
