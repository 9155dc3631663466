"""Connections and requests of the BOPTEST service, besides what its tests do."""

import socket
import threading
from contextlib import ExitStack
from queue import Queue
from urllib.parse import urlsplit

import pytest

pytest.importorskip("fastapi", reason="fastapi is not installed")
pytest.importorskip("httptools", reason="httptools is not installed")

from support.boptest import DAY_S, Client, hold, serving

from zenostat.gateways.boptest import app, server
from zenostat.gateways.boptest.simulation import Simulation


@pytest.mark.slow
def test_boptest__requests_that_wait_for_one_of_their_test_do_not_block_the_service(monkeypatch):
    """advance begins → more requests of the test than there are threads → other requests are answered"""
    in_progress, may_go_on, answers, waiting = threading.Event(), threading.Event(), Queue(), 20
    monkeypatch.setattr(app, "_MAX_QUEUED", waiting)
    with serving(max_tests=1) as client:
        client.select("ref-small-office")
        client.put("step", step=300 * DAY_S)
        monkeypatch.setattr(Simulation, "step", hold(Simulation.step, in_progress, may_go_on))

        def send(method, operation):
            one = Client(client.url)
            answers.put(one.request(method, f"/{operation}/{client.testid}"))
            one.session.close()

        threads = [threading.Thread(target=send, args=("POST", "advance"))]
        threads[0].start()
        assert in_progress.wait(60)
        threads += [threading.Thread(target=send, args=("GET", "name")) for _ in range(waiting + 1)]
        for thread in threads[1:]:
            thread.start()
        excess = answers.get()
        assert (excess.status_code, excess.text) == (503, f"{waiting} requests of this test are waiting already")
        assert client.request("GET", "/testcases").status_code == 200
        assert client.request("PUT", f"/stop/{client.testid}").text == "OK"
        may_go_on.set()
        for thread in threads:
            thread.join()
        assert sorted(answers.get().status_code for _ in threads[1:]) == [400] * waiting + [500]


def test_boptest__connections_without_a_complete_request_are_closed_unless_they_wait_for_an_answer(monkeypatch):
    monkeypatch.setattr(server._Protocol, "request_timeout_s", 0.2)
    in_progress, may_go_on, answers = threading.Event(), threading.Event(), []
    head = b"POST /testcases/none/select HTTP/1.1\r\nHost: localhost\r\n"
    with serving() as client, ExitStack() as stack:
        cases = client.service.manager.cases
        monkeypatch.setattr(cases, "names", hold(cases.names, in_progress, may_go_on))
        thread = threading.Thread(target=lambda: answers.append(client.request("GET", "/testcases")))
        thread.start()
        assert in_progress.wait(60)
        address = urlsplit(client.url)
        for data in (b"", b"GET /vers", head, head + b"Content-Length: 5\r\n\r\n{"):
            connection = socket.create_connection((address.hostname, address.port), timeout=60)
            stack.callback(connection.close)
            connection.sendall(data)
            assert connection.recv(1) == b"", data
        may_go_on.set()
        thread.join()
        assert answers[0].status_code == 200


@pytest.mark.parametrize(
    ("headers", "is_local", "status"),
    [
        ({"Host": "evil.example:8000"}, True, 403),
        ({"Host": "evil.example:8000", "Origin": "http://evil.example:8000"}, True, 403),
        ({"Origin": "http://evil.example"}, True, 403),
        ({"Origin": "null"}, True, 403),
        ({"Host": "localhost:9000", "Origin": "http://localhost:8000"}, True, 403),
        ({"Host": "localhost:9000", "Origin": "http://localhost:9000"}, True, 404),
        ({"Host": "[::1]:8000"}, True, 404),
        ({"Host": "127.0.0.1"}, True, 404),
        ({"Host": "office.example"}, False, 404),
        ({"Host": "office.example", "Origin": "https://office.example"}, False, 404),
        ({"Host": "office.example", "Origin": "https://evil.example"}, False, 403),
    ],
)
def test_boptest__pages_of_other_sites_send_no_requests(sites, headers, is_local, status):
    sites.service.is_local = is_local
    answer = sites.request(
        "POST", "/testcases/none/select", data="{}", headers={"Content-Type": "text/plain", **headers}
    )
    assert answer.status_code == status
    assert (answer.json()["message"] if status == 403 else answer.text[:9]) == (
        "Forbidden" if status == 403 else "Not Found"
    )
    assert sites.service.counts[status] > 0


@pytest.fixture(scope="module")
def sites():
    with serving() as client:
        assert client.service.is_local
        yield client
