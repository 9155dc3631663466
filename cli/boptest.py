"""`zenostat gateway boptest`: BOPTEST's REST interface to scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from zenostat.cli.console import out
from zenostat.cli.gateway_clients import Allow, ClientsFile, clients_of, notify
from zenostat.cli.options import Emissions, Expose, Price
from zenostat.cli.pairs import read_rates
from zenostat.topics.addresses import is_loopback
from zenostat.topics.extras import requires_extra
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from zenostat.gateways.boptest.server import BoptestServer
    from zenostat.gateways.clients import Clients


def boptest(
    testcase: Annotated[
        str | None, typer.Argument(help="Select a test case for clients of old versions, whose paths have no test id.")
    ] = None,
    address: Annotated[str, typer.Option(help="HOST:PORT to listen on; port 0 chooses a free one.")] = "127.0.0.1:8000",
    files: Annotated[
        list[Path] | None, typer.Option("--file", help="Scenario file that is listed as a test case; repeatable.")
    ] = None,
    prices: Price = None,
    emissions: Emissions = None,
    timeout: Annotated[float, typer.Option(min=1.0, help="Seconds without a request after which a test ends.")] = 900.0,
    max_tests: Annotated[int, typer.Option(min=1, help="Maximum number of tests at a time.")] = 16,
    clients: ClientsFile = None,
    allow: Allow = None,
    expose: Expose = False,
) -> None:
    """Serve BOPTEST's REST interface until Ctrl-C; each test starts a building of its own.

    Example: `zenostat gateway boptest --address 127.0.0.1:8000`

    Test cases are all bundled buildings, those of installed data packs, and scenario files. A price may also be that of
    one price scenario: `--price highly_dynamic=prices.csv`.
    """
    with requires_extra("boptest", "the BOPTEST gateway", "FastAPI, uvicorn and httptools"):
        from zenostat.gateways.boptest.app import Service
        from zenostat.gateways.boptest.server import BoptestServer
    from zenostat.cli.boptest_cases import BundledTestCases
    from zenostat.gateways.boptest.manager import TestManager
    from zenostat.gateways.boptest.prices import read_rates as rates_of

    known = clients_of(clients, allow, is_exposed=not is_loopback(address.rpartition(":")[0]))
    rates = rates_of(read_rates("--price", prices), read_rates("--emissions", emissions))
    manager = TestManager(BundledTestCases(files or ()), rates, timeout_s=timeout, max_tests=max_tests, notify=notify)
    service = Service(manager, single=testcase is not None, clients=known)
    with BoptestServer(service, address, expose=expose) as server:
        if testcase is not None:
            service.testid = manager.select(testcase, keep=True)
        _serve(server, testcase, known)


def _serve(server: BoptestServer, testcase: str | None, clients: Clients) -> None:
    """Serve until a signal, and report how many requests there were."""
    with override_signals(lambda *_: server.stop(), *TERMINATION_SIGNALS):
        single = f", {testcase} on the paths without a test id" if testcase else ""
        access = (
            clients.description
            if clients.is_restricted
            else ("no authentication: whoever reaches this address can use it")
        )
        out.print(f"ready: {server.url}{single}; {access}; press Ctrl-C to stop")
        server.run()
    counts = server.service.counts
    rejected = sum(count for status, count in counts.items() if status >= 400)
    out.print(f"{counted(sum(counts.values()), 'request')}, {rejected} of them rejected")
