"""Bad input to the BOPTEST gateway: each request is answered, counted, and moves no actuator that it should not."""

import json
import random
import socket
from urllib.parse import urlsplit

import pytest

pytest.importorskip("fastapi", reason="fastapi is not installed")
pytest.importorskip("httptools", reason="httptools is not installed")

from support.boptest import Client, serving

REQUESTS = 500
METHODS = {
    "advance": "POST", "initialize": "PUT", "scenario": "PUT", "results": "PUT", "forecast": "PUT", "step": "PUT",
    "kpi": "GET", "name": "GET", "inputs": "GET", "measurements": "GET", "forecast_points": "GET", "snapshot": "PUT",
    "baseline": "GET", "submit": "POST", "status": "GET", "branch": "PUT", "version": "GET", "nothing": "GET",
    "testcases": "GET",
}  # fmt: skip
KEYS = (
    "core_zn_cooling_setpoint_u", "core_zn_cooling_setpoint_activate", "core_zn_heating_setpoint_u", "start_time",
    "final_time", "warmup_period", "step", "point_names", "horizon", "interval", "electricity_price", "seed",
    "temperature_uncertainty", "snapshot", "api_key", "tag1", "foo", "",
)  # fmt: skip
VALUES = (
    "NaN", "Infinity", "-Infinity", "1e309", "null", "true", "{}", "[]", '[[["a"]]]', '"\\u0000"', '"NaN"', '"inf"',
    "-1", "0", "0.5", "1e18", "12345678901234567890123", '"constant"', '"TDryBul"', '["TDryBul", 5]',
    f'"{"y" * 5000}"',
)  # fmt: skip
SAFE = {200, 400, 404, 405}


@pytest.fixture(scope="module")
def client():
    with serving() as running:
        running.select("ref-small-office")
        running.put("step", step=900)
        yield running


def body(rng: random.Random) -> bytes:
    choice = rng.random()
    if choice < 0.1:
        return rng.randbytes(rng.randrange(300))
    fields = ", ".join(f"{json.dumps(rng.choice(KEYS))}: {rng.choice(VALUES)}" for _ in range(rng.randrange(5)))
    text = f"{{{fields}}}".encode()
    return text[: rng.randrange(len(text))] if choice < 0.2 else text


def test_boptest__any_request_is_answered_and_counted_and_the_building_remains_controllable(client: Client):
    rng = random.Random(7)
    before = sum(client.service.counts.values())
    sent = 0
    for _ in range(REQUESTS):
        path, method = rng.choice([*METHODS.items()])
        testid = rng.choice([client.testid] * 8 + ["", "foo", "%00", "../..", "a" * 3000])
        if rng.random() < 0.1:
            method = rng.choice(["GET", "PUT", "POST", "DELETE"])
        if path in ("branch", "snapshot") and (method, testid) == ("POST", client.testid):
            continue  # both are good requests, and each keeps an engine
        kind = rng.choice(["application/json", "application/x-www-form-urlencoded", "text/plain", "image/png", ""])
        answer = client.request(method, f"/{path}/{testid}", data=body(rng), headers={"content-type": kind})
        sent += 1
        assert answer.status_code in SAFE, (method, path, answer.text[:300])
        assert "Traceback" not in answer.text
    assert sum(client.service.counts.values()) - before == sent
    assert client.service.counts[400] > REQUESTS / 4
    client.put("initialize", start_time=0, warmup_period=0)
    client.put("step", step=900)
    name = "core_zn_cooling_setpoint"
    state = client.advance(**{f"{name}_u": 297.15, f"{name}_activate": 1})
    assert state[f"{name}_u"] == 297.15
    assert [n for n, v in state.items() if n.endswith("_activate") and v] == [f"{name}_activate"]


@pytest.mark.parametrize("value", ["NaN", '"nan"', "{}", "[24]", "true", '"warm"', "1e309"])
def test_boptest__bad_value_beside_good_ones_moves_nothing(client: Client, value: str):
    client.put("initialize", start_time=0, warmup_period=0)
    text = (
        '{"core_zn_heating_setpoint_u": 295.15, "core_zn_heating_setpoint_activate": 1,'
        f' "core_zn_cooling_setpoint_u": {value}, "core_zn_cooling_setpoint_activate": 1}}'
    )
    answer = client.request("POST", f"/advance/{client.testid}", data=text)
    if value == "1e309":  # infinity is beyond the bound: clipped
        assert answer.json()["payload"]["core_zn_cooling_setpoint_u"] == pytest.approx(303.15)
        return
    assert (answer.status_code, answer.json()["message"]) == (400, "Bad Request")
    state = client.advance()
    assert state["time"] == 900
    assert not any(value for name, value in state.items() if name.endswith("_activate"))


def test_boptest__broken_http_and_clients_that_leave_do_not_end_the_service(client: Client):
    client.put("initialize", start_time=0, warmup_period=0)
    address = urlsplit(client.url)
    head = f"POST /advance/{client.testid} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    for data in (
        b"\x00\xff" * 50,
        b"GET",
        f"{head}Content-Length: 100\r\n\r\n{{".encode(),
        f"{head}Content-Length: -5\r\n\r\n".encode(),
        f"{head}Transfer-Encoding: chunked\r\n\r\nzz\r\n".encode(),
        b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"a" * 200_000,
        f"{head}Content-Length: 2000000\r\n\r\n".encode() + b" " * 2_000_000,
    ):
        with socket.create_connection((address.hostname, address.port), timeout=30) as connection:
            try:
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(4096):
                    pass
            except (BrokenPipeError, ConnectionResetError):
                continue
    assert client.put("results", point_names=["time"], start_time=0, final_time=1e9)["time"] == [0]
    assert client.advance()["time"] == 900
