"""Access to the page: sign-in by one-time tokens, sessions in strict cookies, and checks of each request.

The page runs in a browser beside pages of strangers. So a request must name this server as its `Host` (a name that
somebody else resolves to this machine is rejected), a change must come from this page by its `Origin`, and both need
the cookie of a session, which no script can read and which no other site's request carries. Over a network, the names
and roles of users are those of the bus, and a browser may prove its user's name by a certificate instead.
"""

from __future__ import annotations

import hashlib
import re
import secrets
import time
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass, field, replace
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import JSONResponse

from zenostat.topics.errors import UnknownName
from zenostat.topics.keys import Role
from zenostat.views.room.users import CERTIFICATE, BusUsers, ClientCertificate

ASGIApp = Callable[[MutableMapping[str, Any], Callable[[], Awaitable[Any]], Callable[[Any], Awaitable[None]]], Any]

OPERATOR = r"^[A-Za-z0-9_][A-Za-z0-9_.\-]{0,63}$"
"""Pattern of an operator's name, which is part of the keys of this operator's requests."""


def check_name_of(text: str) -> str:
    """Return a name of an operator or of a file on the page; ValueError if it is none."""
    if not re.fullmatch(OPERATOR, text):
        raise ValueError("1 to 64 letters, digits, '_', '.' or '-' expected, of which the first is no '.' or '-'")
    return text


MAX_PAGE_AGE_S = 30.0
"""Largest age of what a page has received last when a change of it arrives."""

MAX_BODY_BYTES = 1 << 20
"""Largest body of a request; a fault plan is the largest of them."""

_MAX_SESSIONS = 64
_MAX_TOKENS = 16
_IDLE_S = 12 * 3600.0
_TOKEN_S = 3600.0
_OPEN = ("/", "/api/session", "/health")
_PROGRAM_PATHS = ("/metrics", "/grafana")
_OPERATORS = ("/api/builder", "/api/audit")
"""Paths that monitors cannot read either."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; trusted-types 'none'"
)
"""Content security policy: nothing but this server's own files, no inline script or style, no HTML from texts."""

_SIGN_IN = "sign in with a link that `zenostat room` prints, or a certificate of an operator, monitor or controller"

_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "DENY",
}


@dataclass(slots=True)
class Session:
    """A browser that has signed in.

    Attributes:
        operator: name of its user, the source of all changes.
        used_s: time of its latest request.
        role: `operator`, or `monitor`, who changes nothing.
    """

    operator: str
    used_s: float = field(compare=False)
    role: Role = Role.OPERATOR


def operator_of(request: Request) -> str:
    """Return the name of the user whose session a request belongs to."""
    session: Session = request.state.session
    return session.operator


class Access:
    """The tokens and sessions of a server, for its event loop's thread.

    Args:
        hosts: permitted values of the header `Host`.
        cookie: name of the cookie; browsers share cookies between all ports of a host.
        api_token: token of programs that use the program paths; None closes these.
        program_paths: beginnings of the paths for programs, which need the token and no session.
        hint: where the token is from, for the error of a request without it.
        scheme: of the page, `http` or `https`.
        users: names and roles of the bus; None: whoever has signed in is an operator.
        clock: monotonic time in seconds.
        wall_clock: time in seconds, as in the ids of `Updates`.
    """

    def __init__(
        self,
        hosts: frozenset[str],
        cookie: str,
        *,
        api_token: str | None = None,
        program_paths: tuple[str, ...] = _PROGRAM_PATHS,
        hint: str = "see --api-token-file",
        scheme: str = "http",
        users: BusUsers | None = None,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self.hosts, self.cookie, self.scheme, self._users = hosts, cookie, scheme, users
        self._program_paths, self._hint = program_paths, hint
        self._api_digest = None if api_token is None else _digest(api_token)
        self._clock, self._wall_clock = clock, wall_clock
        self._tokens: dict[str, tuple[str, float]] = {}
        self._sessions: dict[str, Session] = {}

    @property
    def cookie_settings(self) -> dict[str, Any]:
        """Settings of the cookie: no script reads it, and no other site's request carries it."""
        return {"path": "/", "httponly": True, "samesite": "strict", "secure": self.scheme == "https"}

    def role(self, name: str) -> Role | None:
        """Return what a user may do now: `operator` or `monitor`; None for nothing."""
        return Role.OPERATOR if self._users is None else self._users.role(name)

    def invite(self, operator: str) -> str:
        """Return a token that signs one browser in, once and within an hour, as this operator.

        Raises:
            UnknownName: the bus has no operator, monitor or controller of that name.
        """
        if self.role(operator) is None:
            raise UnknownName(
                f"{operator!r} is no operator, monitor or controller in the list of names of the bus; create "
                f"a certificate with: zenostat keys add {operator} --role monitor (reads) or --role operator (changes)"
            )
        token = secrets.token_urlsafe(32)
        while len(self._tokens) >= _MAX_TOKENS:
            del self._tokens[next(iter(self._tokens))]
        self._tokens[_digest(token)] = (operator, self._clock() + _TOKEN_S)
        return token

    def sign_in(self, token: str) -> tuple[str, Session] | None:
        """Exchange a token for the id of a new session; None if it is unknown, used or expired."""
        operator, until_s = self._tokens.pop(_digest(token), ("", 0.0))
        if self._clock() >= until_s or self.role(operator) is None:  # which may have been revoked since
            return None
        identity, session = secrets.token_urlsafe(32), Session(operator, self._clock())
        while len(self._sessions) >= _MAX_SESSIONS:
            oldest = min(self._sessions, key=lambda digest: self._sessions[digest].used_s)
            del self._sessions[oldest]
        self._sessions[_digest(identity)] = session
        return identity, session

    def session(self, identity: str | None) -> Session | None:
        """Return the session of this id, which is then used again; None if it is unknown or was idle for 12 hours."""
        session = self._lasting(identity)
        if session is None:
            self.sign_out(identity)
        else:
            session.used_s = self._clock()
        return session

    def _lasting(self, identity: str | None) -> Session | None:
        """Return the session of an id if it has not ended; its use is not noted."""
        session = self._sessions.get(_digest(identity or ""))
        return session if session is not None and self._clock() - session.used_s <= _IDLE_S else None

    def sign_out(self, identity: str | None) -> None:
        """End a session."""
        self._sessions.pop(_digest(identity or ""), None)

    def allows_program(self, authorization: str) -> bool:
        """Return whether a header `Authorization` has the token of programs."""
        kind, _, token = authorization.partition(" ")
        if self._api_digest is None or kind.lower() != "bearer":
            return False
        return secrets.compare_digest(_digest(token), self._api_digest)

    def rejection(self, scope: MutableMapping[str, Any]) -> tuple[int, str] | None:
        """Return status and text for a request that is not permitted; None if it is.

        A session that is permitted is in `scope["state"]["session"]`.
        """
        headers, method, path = Headers(scope=scope), scope["method"], scope["path"]
        host = headers.getlist("host")
        if len(host) != 1 or host[0].lower() not in self.hosts:
            return 421, f"this server is none of that name; open {sorted(self.hosts)[0]}"
        if method not in ("GET", "HEAD", "POST", "DELETE"):
            return 405, "no such method"
        if path.startswith(self._program_paths):
            if not self.allows_program(headers.get("authorization", "")):
                return 401, f"a bearer token is required; {self._hint}"
            return None
        return self._foreign(headers, method, path) or self._not_permitted(scope, method, path)

    def outdated(self, scope: MutableMapping[str, Any]) -> str:
        """Return why a change is refused whose page had received nothing for too long; empty if it is not.

        A lost connection keeps what was sent over it, also that of a page that is gone, and delivers it when the
        connection is back, minutes later. So a page names the latest event that it has received, whose id is a time.
        """
        event = Headers(scope=scope).get("last-event-id")
        if scope["method"] in ("GET", "HEAD") or scope["path"] == "/api/session" or event is None:
            return ""
        try:
            age_s = self._wall_clock() - float(event)
        except ValueError:
            return f"the id of an event expected, not {event[:40]!r}"
        if abs(age_s) <= MAX_PAGE_AGE_S:
            return ""
        return f"nothing was done: the page had received nothing for {age_s:.0f} s when this came; look, and try again"

    def _foreign(self, headers: Headers, method: str, path: str) -> tuple[int, str] | None:
        """Return status and text for a request that another site's page may have sent; None for one of this page."""
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none") and path != "/":
            return 403, "a request of another site"
        origins = headers.getlist("origin")
        if method in ("GET", "HEAD") and not origins:
            return None
        if origins != [f"{self.scheme}://{headers['host']}"]:
            return 403, "a change must come from this page"
        if method == "POST" and headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
            return 415, "application/json expected"
        return None

    def _not_permitted(self, scope: MutableMapping[str, Any], method: str, path: str) -> tuple[int, str] | None:
        """Return status and text for a request that its user may not send; None if the user may."""
        self.session(Request(scope).cookies.get(self.cookie))
        session = self.user(scope)
        scope.setdefault("state", {})["session"] = session
        if path == "/api/session":
            return None
        if session is None:
            if path in _OPEN or path.startswith("/static/"):
                return None
            return 401, self.denial(scope) or _SIGN_IN
        if session.role is Role.OPERATOR:
            return None
        if method not in ("GET", "HEAD"):
            return 403, f"{session.operator} may only read; changes need an operator"
        return (
            (403, f"{session.operator} may not read this; it is for operators") if path.startswith(_OPERATORS) else None
        )

    def user(self, scope: MutableMapping[str, Any]) -> Session | None:
        """Return name and role that whoever has sent a request has now; None for nobody. No use is noted."""
        # Whoever has signed in by a link has chosen that name; a browser sends its certificate in any case.
        proofs = (self._lasting(Request(scope).cookies.get(self.cookie)), self._proven(scope))
        sessions = (replace(each, role=role) for each in proofs if each and (role := self.role(each.operator)))
        return next(sessions, None)

    def denial(self, scope: MutableMapping[str, Any]) -> str:
        """Return why what a request presents proves no user, for who has no user; empty if it presents nothing."""
        if self._users is None:
            return ""
        certificate, session = _certificate(scope), self._lasting(Request(scope).cookies.get(self.cookie))
        if session is None and certificate.expired:
            return certificate.expired
        name = session.operator if session else certificate.name
        return self._users.denial(name) if name else ""

    def _proven(self, scope: MutableMapping[str, Any]) -> Session | None:
        """Return a session for the name in the connection's certificate; None without one."""
        certificate = _certificate(scope)
        name = certificate.valid_name if self._users is not None else ""
        return Session(name, self._clock()) if name else None


class Guard:
    """ASGI middleware: rejects what `Access` does not permit, reads bodies, and adds the headers of each response.

    The application has the whole body of a request at once; one that is too long, or whose client leaves while sending
    it, does not reach the application.

    Args:
        app: the application.
        access: what it permits.
        on_denied: receives name, method, path and reason of each request of a user that is rejected, such as one that
            the user's role does not permit.
    """

    def __init__(
        self, app: ASGIApp, access: Access, on_denied: Callable[[str, str, str, str], None] | None = None
    ) -> None:
        self._app, self._access, self._on_denied = app, access, on_denied

    async def __call__(
        self,
        scope: MutableMapping[str, Any],
        receive: Callable[[], Awaitable[Any]],
        send: Callable[[Any], Awaitable[None]],
    ) -> None:
        """Handle a request; connections of other kinds are ended."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        if scope["type"] != "http":
            return

        async def send_with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("cache-control", "no-store")
            await send(message)

        body: bytes | None = b""
        rejection = self._access.rejection(scope)
        if rejection is None:
            body = await _read(receive)
            if body is None:
                return
            rejection = self._late_rejection(scope, body)
        if rejection is not None:
            self._report_denied(scope, rejection[1])
            await _reject(*rejection)(scope, receive, send_with_headers)
            return
        received = iter([{"type": "http.request", "body": body, "more_body": False}])

        async def receive_next() -> Any:
            return next(received, None) or await receive()

        await self._app(scope, receive_next, send_with_headers)

    def _late_rejection(self, scope: MutableMapping[str, Any], body: bytes) -> tuple[int, str] | None:
        """Return status and text for a request that is rejected once its body is there; None if it is not."""
        if len(body) > MAX_BODY_BYTES:
            return 413, "the body is too large"
        reason = self._access.outdated(scope)
        return (409, reason) if reason else None

    def _report_denied(self, scope: MutableMapping[str, Any], reason: str) -> None:
        """Report a rejected request if it is one of a user."""
        session: Session | None = scope.get("state", {}).get("session")
        if session is not None and self._on_denied is not None:
            self._on_denied(session.operator, scope["method"], scope["path"], reason)


def _reject(status: int, text: str) -> JSONResponse:
    error = {409: "RequestRejected", 413: "BadMessage"}.get(status, "AccessDenied")
    return JSONResponse({"error": error, "message": text}, status)


async def _read(receive: Callable[[], Awaitable[Any]]) -> bytes | None:
    """Return the body of a request, or its beginning if it is too long; None if the client leaves before its end."""
    body, has_more = bytearray(), True
    while has_more and len(body) <= MAX_BODY_BYTES:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        body += message.get("body", b"")
        has_more = message.get("more_body", False)
    return bytes(body)


def _certificate(scope: MutableMapping[str, Any]) -> ClientCertificate:
    """Return what the certificate of a request's connection states."""
    certificate: ClientCertificate = scope.get("state", {}).get(CERTIFICATE, ClientCertificate())
    return certificate


def _digest(secret: str) -> str:
    """Return a hash: comparing and looking up hashes takes no time that depends on a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()
