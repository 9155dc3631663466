"""Sign-in and the checks of each request, without a server."""

from typing import Any

import pytest

pytest.importorskip("starlette")

from support.clock import Clock

from zenostat.views.room.access import MAX_BODY_BYTES, POLICY, Access, Guard

HOST = "127.0.0.1:8600"
TOKEN = "t" * 32


@pytest.fixture
def access(clock: Clock) -> Access:
    return Access(frozenset({HOST, "localhost:8600"}), "room", api_token=TOKEN, clock=clock, wall_clock=clock)


def scope(method: str = "GET", path: str = "/api/session", **headers: str) -> dict[str, Any]:
    names = {name.replace("_", "-"): value for name, value in {"host": HOST, **headers}.items()}
    raw = [(name.encode(), value.encode()) for name, value in names.items()]
    return {"type": "http", "method": method, "path": path, "headers": raw}


def signed_in(access: Access) -> str:
    result = access.sign_in(access.invite("Ada"))
    assert result is not None
    return f"room={result[0]}"


def status(access: Access, request: dict[str, Any]) -> int:
    rejection = access.rejection(request)
    return 200 if rejection is None else rejection[0]


def test_access__token_signs_in_once_as_its_operator(access: Access) -> None:
    token = access.invite("Ada")
    result = access.sign_in(token)
    assert result is not None
    assert result[1].operator == "Ada"
    assert access.session(result[0]) is result[1]
    assert access.sign_in(token) is None


@pytest.mark.parametrize("token", ["", "unknown", "ü"])
def test_access__unknown_token_signs_nobody_in(access: Access, token: str) -> None:
    access.invite("Ada")
    assert access.sign_in(token) is None


def test_access__token_expires_after_an_hour(access: Access, clock: Clock) -> None:
    first, second = access.invite("Ada"), access.invite("Grace")
    clock.now_s = 3599.0
    assert access.sign_in(first) is not None
    clock.now_s = 3600.0
    assert access.sign_in(second) is None


def test_access__session_ends_after_twelve_idle_hours(access: Access, clock: Clock) -> None:
    cookie = signed_in(access)
    for hour in (11, 22):  # in use
        clock.now_s = hour * 3600.0
        assert status(access, scope(path="/api/stream", cookie=cookie)) == 200
    clock.now_s = 34.1 * 3600.0
    assert status(access, scope(path="/api/stream", cookie=cookie)) == 401


def test_access__sign_out_ends_the_session(access: Access) -> None:
    cookie = signed_in(access)
    access.sign_out(cookie.partition("=")[2])
    assert status(access, scope(path="/api/stream", cookie=cookie)) == 401


def test_access__numbers_of_tokens_and_sessions_are_limited(access: Access) -> None:
    tokens = [access.invite("Ada") for _ in range(100)]
    assert sum(access.sign_in(token) is not None for token in tokens) == 16
    cookies = [signed_in(access) for _ in range(200)]
    assert sum(status(access, scope(path="/api/stream", cookie=cookie)) == 200 for cookie in cookies) == 64


@pytest.mark.parametrize(
    "host", ["evil.example:8600", "127.0.0.1", "127.0.0.1:8601", "127.0.0.1:8600.evil.example", ""]
)
def test_access__another_host_is_rejected(access: Access, host: str) -> None:
    assert status(access, scope(host=host, cookie=signed_in(access))) == 421


def test_access__two_hosts_are_rejected(access: Access) -> None:
    request = scope(cookie=signed_in(access))
    request["headers"].append((b"host", b"evil.example"))
    assert status(access, request) == 421


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({"origin": f"http://{HOST}"}, 200),
        ({}, 403),
        ({"origin": "null"}, 403),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": f"https://{HOST}"}, 403),
        ({"origin": "http://localhost:8600"}, 403),
        ({"origin": f"http://{HOST}.evil.example"}, 403),
        ({"origin": f"http://{HOST}", "sec_fetch_site": "same-site"}, 403),
        ({"origin": f"http://{HOST}", "sec_fetch_site": "cross-site"}, 403),
        ({"origin": f"http://{HOST}", "sec_fetch_site": "same-origin"}, 200),
        ({"origin": f"http://{HOST}", "content_type": "Application/JSON; charset=utf-8"}, 200),
        ({"origin": f"http://{HOST}", "content_type": "text/plain"}, 415),
        ({"origin": f"http://{HOST}", "content_type": "application/x-www-form-urlencoded"}, 415),
    ],
)
def test_access__change_must_come_from_the_page(access: Access, headers: dict[str, str], expected: int) -> None:
    headers = {"content_type": "application/json", "cookie": signed_in(access), **headers}
    assert status(access, scope("POST", "/api/nodes/office/pause", **headers)) == expected


def test_access__another_site_cannot_read(access: Access) -> None:
    cookie = signed_in(access)
    assert status(access, scope(path="/api/stream", cookie=cookie, sec_fetch_site="cross-site")) == 403
    assert status(access, scope(path="/api/stream", cookie=cookie, origin="http://evil.example")) == 403
    assert status(access, scope(path="/", sec_fetch_site="cross-site")) == 200  # a link to the page


@pytest.mark.parametrize("method", ["PUT", "PATCH", "OPTIONS", "TRACE", "CONNECT"])
def test_access__other_methods_are_rejected(access: Access, method: str) -> None:
    assert status(access, scope(method, cookie=signed_in(access), origin=f"http://{HOST}")) == 405


def test_access__without_a_session_only_the_page_is_open(access: Access) -> None:
    for path in ("/", "/static/main.js", "/health", "/api/session"):
        assert status(access, scope(path=path)) == 200
    for path in ("/api/stream", "/api/nodes/office", "/api/nodes/office/history", "/unknown"):
        assert status(access, scope(path=path)) == 401
        assert status(access, scope(path=path, cookie="room=unknown")) == 401


@pytest.mark.parametrize("path", ["/metrics", "/grafana/query"])
def test_access__programs_need_their_token(access: Access, path: str) -> None:
    assert status(access, scope(path=path, authorization=f"Bearer {TOKEN}")) == 200
    for authorization in ("", f"Basic {TOKEN}", "Bearer ", f"Bearer {TOKEN}x"):
        assert status(access, scope(path=path, authorization=authorization)) == 401
    assert status(access, scope(path=path, cookie=signed_in(access))) == 401
    closed = Access(frozenset({HOST}), "room")
    assert status(closed, scope(path=path, authorization="Bearer ")) == 401


def test_access__policy_allows_nothing_unsafe() -> None:
    assert "unsafe" not in POLICY
    assert "default-src 'none'" in POLICY
    assert "http" not in POLICY


@pytest.mark.parametrize(
    ("age_s", "is_refused"), [(0.0, False), (30.0, False), (31.0, True), (600.0, True), (-31.0, True)]
)
async def test_guard__change_of_a_page_that_had_received_nothing_for_long_is_refused(
    access: Access, clock: Clock, age_s: float, *, is_refused: bool
) -> None:
    clock.now_s = 1_000_000.0
    last = {"last_event_id": f"{clock.now_s - age_s:.3f}"}
    bodies, statuses = await guarded(access, part(b"{}"), **last)
    assert (bodies, statuses) == (([], [409]) if is_refused else ([b"{}"], []))
    reason = access.outdated(scope("POST", "/api/nodes/office/pause", **last))
    assert (f"received nothing for {age_s:.0f} s" in reason) == is_refused
    for method, path in (("GET", "/api/nodes/office"), ("POST", "/api/session"), ("DELETE", "/api/session")):
        assert access.outdated(scope(method, path, **last)) == ""  # nothing of the building is changed


@pytest.mark.parametrize("event", ["", "x", "nan", "inf", "1e999"])
def test_access__change_with_another_event_than_the_servers_is_refused(access: Access, event: str) -> None:
    assert access.outdated(scope("POST", "/api/nodes/office/pause", last_event_id=event))


async def guarded(access: Access, *messages: dict[str, Any], **headers: str) -> tuple[list[bytes], list[int]]:
    """Bodies that the application receives of a permitted request, and the statuses that the client receives."""
    receiving, bodies, statuses = iter(messages), [], []

    async def receive() -> dict[str, Any]:
        return next(receiving, {"type": "http.disconnect"})

    async def send(message: dict[str, Any]) -> None:
        statuses.extend([message["status"]] if message["type"] == "http.response.start" else [])

    async def app(_: Any, receive_next: Any, __: Any) -> None:
        bodies.append((await receive_next())["body"])
        assert (await receive_next())["type"] == "http.disconnect"

    request = scope("POST", "/grafana/query", authorization=f"Bearer {TOKEN}", **headers)
    await Guard(app, access)(request, receive, send)
    return bodies, statuses


def part(body: bytes, *, is_last: bool = True) -> dict[str, Any]:
    return {"type": "http.request", "body": body, "more_body": not is_last}


async def test_guard__application_has_whole_bodies_only(access: Access) -> None:
    assert await guarded(access, part(b"{", is_last=False), part(b"}")) == ([b"{}"], [])
    assert await guarded(access, part(b"{", is_last=False)) == ([], [])  # the client has left
    assert await guarded(access, part(b" " * MAX_BODY_BYTES)) == ([b" " * MAX_BODY_BYTES], [])
    too_long = part(b" " * MAX_BODY_BYTES, is_last=False), part(b" ")
    assert await guarded(access, *too_long) == ([], [413])
