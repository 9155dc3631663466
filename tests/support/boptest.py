"""A BOPTEST service in this process, and requests to it as BOPTEST's clients send them."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import requests

from support.http_servers import running
from zenostat.cli.boptest_cases import BundledTestCases
from zenostat.gateways.boptest.app import Service
from zenostat.gateways.boptest.manager import TestManager
from zenostat.gateways.boptest.prices import read_rates
from zenostat.gateways.boptest.server import BoptestServer
from zenostat.gateways.clients import UNRESTRICTED, Clients

DAY_S = 86400


class Client:
    """Requests to a service; `payload` and its relatives check the envelope."""

    def __init__(self, url: str, service: Service | None = None) -> None:
        self.url, self.service, self.session = url, service, requests.Session()
        self.testid = ""

    def request(self, method: str, path: str, **kwargs: Any) -> requests.Response:
        return self.session.request(method, f"{self.url}{path}", timeout=120, **kwargs)

    def select(self, name: str) -> str:
        answer = self.request("POST", f"/testcases/{name}/select")
        assert answer.status_code == 200, answer.text
        self.testid = answer.json()["testid"]
        return self.testid

    def answer(self, method: str, operation: str, body: dict[str, Any] | None = None) -> requests.Response:
        return self.request(method, f"/{operation}/{self.testid}", json=body)

    def payload(self, method: str, operation: str, body: dict[str, Any] | None = None) -> Any:
        answer = self.answer(method, operation, body)
        envelope = answer.json()
        assert answer.status_code == envelope["status"] == 200, answer.text
        return envelope["payload"]

    def get(self, operation: str) -> Any:
        return self.payload("GET", operation)

    def put(self, operation: str, **body: Any) -> Any:
        return self.payload("PUT", operation, body)

    def advance(self, **inputs: Any) -> Any:
        return self.payload("POST", "advance", inputs)


@contextmanager
def serving(
    *, single: str | None = None, clients: Clients = UNRESTRICTED, files: Sequence[Path] = (), **options: Any
) -> Iterator[Client]:
    """Run a service on a free port of loopback; in the end all tests are ended."""
    manager = TestManager(BundledTestCases(files), read_rates(), **options)
    service = Service(manager, single=single is not None, clients=clients)
    with BoptestServer(service, "127.0.0.1:0") as server:
        if single is not None:
            service.testid = manager.select(single, keep=True)
        with running(server), (client := Client(server.url, service)).session:
            yield client


def hold(function: Callable[..., Any], in_progress: threading.Event, may_go_on: threading.Event) -> Callable[..., Any]:
    """Return a function that signals when it has its result, and may return it later."""

    def held(*arguments: Any) -> Any:
        result = function(*arguments)
        in_progress.set()
        assert may_go_on.wait(60)
        return result

    return held
