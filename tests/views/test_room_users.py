"""The control room over a network: TLS, and users with the names and roles of the bus."""

import json
import ssl
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.control_room import NEEDS_CHROMIUM, chromium, control_room
from support.nodes import NodeProgram, free_port, until
from support.tank_plant import TANK
from typer.testing import CliRunner

import zenostat
from zenostat.bridge.transport import certificates
from zenostat.bridge.transport.deny_list import revoke
from zenostat.cli.commands import app
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.keys import Role

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

import httpx
from support.clock import Clock

from zenostat.views.room import users
from zenostat.views.room.access import Access
from zenostat.views.room.users import CERTIFICATE, BusUsers, ClientCertificate, PageTls, client_certificate

HOST = "room.example.org:8600"
NEVER_S = 4e9


@pytest.fixture
def access(keys: Path, clock: Clock) -> Access:
    users = BusUsers(keys, clock)
    return Access(frozenset({HOST}), "__Host-room", scheme="https", users=users, clock=clock)


def request(name: str, method: str = "GET", path: str = "/api/stream", **more: Any) -> dict[str, Any]:
    """A request of a browser with the certificate of a name."""
    headers = {"host": HOST, "content-type": "application/json"}
    headers |= {"origin": f"https://{HOST}"} if method == "POST" else {}
    headers |= {key.replace("_", "-"): value for key, value in more.pop("headers", {}).items()}
    return {
        "type": "http",
        "method": method,
        "path": path,
        "headers": [(key.encode(), value.encode()) for key, value in headers.items()],
        "state": {CERTIFICATE: ClientCertificate(name, more.get("expires_s", NEVER_S))},
    }


def status(access: Access, name: str, *where: str, **more: Any) -> int:
    """The status of a request of a browser with the certificate of a name."""
    rejection = access.rejection(request(name, *where, **more))
    return 200 if rejection is None else rejection[0]


@pytest.mark.parametrize(
    ("name", "read", "change", "build"),
    [
        ("ada", 200, 200, 200),
        ("trainer", 200, 200, 200),  # controller and operator
        ("wall", 200, 403, 403),
        ("controller", 200, 403, 403),
        ("gateway", 401, 401, 401),
        ("node", 401, 401, 401),
        ("room", 401, 401, 401),
        ("stranger", 401, 401, 401),
        ("", 401, 401, 401),
    ],
)
def test_access__roles_are_those_of_the_bus(access: Access, name: str, read: int, change: int, build: int) -> None:
    assert status(access, name) == read
    assert status(access, name, "POST", "/api/nodes/office/pause") == change
    assert status(access, name, path="/api/builder") == build
    assert status(access, name, "POST", "/api/builder/start") == change
    assert status(access, name, path="/") == 200


def test_access__certificate_alone_does_not_permit_another_site(access: Access) -> None:
    change = {"method": "POST", "path": "/api/nodes/office/pause"}
    assert status(access, "ada", **change, headers={"origin": "https://evil.example"}) == 403
    assert status(access, "ada", **change, headers={"origin": f"http://{HOST}"}) == 403
    assert status(access, "ada", headers={"sec_fetch_site": "cross-site"}) == 403


def test_access__certificate_that_proves_no_user_is_refused_with_the_reason(clock: Clock, copied_keys: Path) -> None:
    access = Access(frozenset({HOST}), "room", scheme="https", users=BusUsers(copied_keys, clock), clock=clock)
    revoke(copied_keys, "eve")
    clock.now_s = 1.1
    remedy = "renew it with: zenostat keys add NAME --role ROLE --force"
    expired = (401, f"the certificate of ada expired on 2001-09-09 01:46 UTC; {remedy}")
    assert access.rejection(request("ada", expires_s=1e9)) == expired
    assert access.rejection(request("eve")) == (401, "eve is revoked")
    unlisted = "node is no operator, monitor or controller in the list of names of the bus"
    assert access.rejection(request("node")) == (401, unlisted)
    nobody = access.rejection(request(""))
    assert nobody is not None
    assert nobody[1].startswith("sign in with a link")


def test_access__user_is_who_proves_the_name_now(access: Access, monkeypatch: pytest.MonkeyPatch) -> None:
    signed_in = access.sign_in(access.invite("wall"))
    assert signed_in is not None
    by_certificate = request("ada", expires_s=2e9)
    by_both = request("ada", expires_s=2e9, headers={"cookie": f"__Host-room={signed_in[0]}"})

    def names() -> list[str | None]:
        sessions = [access.user(each) for each in (by_certificate, by_both)]
        return [session and session.operator for session in sessions]

    monkeypatch.setattr(users, "time", SimpleNamespace(time=lambda: 1.9e9))
    assert names() == ["ada", "wall"]
    access.sign_out(signed_in[0])
    assert names() == ["ada", "ada"]
    monkeypatch.setattr(users, "time", SimpleNamespace(time=lambda: 2e9))
    assert names() == [None, None]


def test_access__link_is_for_names_of_the_bus_and_has_their_role(access: Access) -> None:
    with pytest.raises(UnknownName, match="keys add mallory"):
        access.invite("mallory")
    signed_in = access.sign_in(access.invite("wall"))
    assert signed_in is not None
    cookie = {"cookie": f"__Host-room={signed_in[0]}"}
    assert status(access, "", headers=cookie) == 200
    assert status(access, "", "POST", "/api/nodes/office/pause", headers=cookie) == 403


@pytest.mark.parametrize(
    ("certificate", "link", "change"),
    [
        ("gateway", "ada", 200),
        ("room", "wall", 403),
        ("stranger", "ada", 200),
        ("wall", "ada", 200),
        ("ada", "wall", 403),
    ],
)
def test_access__link_precedes_a_certificate(access: Access, certificate: str, link: str, change: int) -> None:
    signed_in = access.sign_in(access.invite(link))
    assert signed_in is not None
    cookie = {"cookie": f"__Host-room={signed_in[0]}"}
    assert status(access, certificate, headers=cookie) == 200
    assert status(access, certificate, "POST", "/api/nodes/office/pause", headers=cookie) == change
    before = status(access, certificate)
    access.sign_out(signed_in[0])
    assert status(access, certificate, headers=cookie) == before


@pytest.fixture
def copied_keys(tmp_path: Path, keys: Path) -> Path:
    """A folder of the bus's keys in which names can be added and revoked."""
    for file in ("ca.pem", "ca.key", "names.json"):
        (tmp_path / file).write_bytes((keys / file).read_bytes())
    (tmp_path / "ca.key").chmod(0o600)
    return tmp_path


def test_access__certificate_permits_what_a_revoked_session_does_not(clock: Clock, copied_keys: Path) -> None:
    access = Access(frozenset({HOST}), "room", scheme="https", users=BusUsers(copied_keys, clock), clock=clock)
    signed_in = access.sign_in(access.invite("eve"))
    assert signed_in is not None
    revoke(copied_keys, "eve")
    clock.now_s = 1.1
    assert status(access, "wall", headers={"cookie": f"room={signed_in[0]}"}) == 200


def test_access__revoked_name_loses_its_session_and_added_one_is_followed(clock: Clock, copied_keys: Path) -> None:
    access = Access(frozenset({HOST}), "room", scheme="https", users=BusUsers(copied_keys, clock), clock=clock)
    signed_in = access.sign_in(access.invite("eve"))
    assert signed_in is not None
    cookie = {"cookie": f"room={signed_in[0]}"}
    assert status(access, "", headers=cookie) == status(access, "eve") == 200
    revoke(copied_keys, "eve")
    certificates.add(copied_keys, Role.MONITOR, "late")
    clock.now_s = 1.1
    assert status(access, "", headers=cookie) == status(access, "eve") == 401
    assert status(access, "late") == status(access, "ada") == 200
    (copied_keys / "names.json").write_text("{}")  # damaged: what was read stays
    (copied_keys / "revoked.txt").unlink()
    clock.now_s = 2.3
    assert (status(access, "ada"), status(access, "eve")) == (200, 401)


def test_client_certificate__of_no_or_two_names_is_none() -> None:
    date = {"notAfter": "Jan  1 00:00:00 2099 GMT"}
    one = ((("organizationalUnitName", "operator"),), (("commonName", "ada"),))
    assert client_certificate({"subject": one, **date}).valid_name == "ada"
    assert client_certificate({"subject": (*one, (("commonName", "eve"),)), **date}).valid_name == ""
    assert client_certificate(None).valid_name == client_certificate({}).valid_name == ""


def test_page_tls__files_that_cannot_be_used_are_named(keys: Path, tmp_path: Path) -> None:
    page = PageTls(keys / "room.pem", keys / "room.key", keys)
    assert page.hosts() == ("localhost", "127.0.0.1", "[::1]", "room.example.org")
    assert page.settings()["ssl_cert_reqs"] is ssl.CERT_OPTIONAL
    with pytest.raises(InvalidConfig, match="key"):
        PageTls(keys / "room.pem", keys / "ada.key", keys).settings()
    with pytest.raises(InvalidConfig, match="names of this machine"):
        PageTls(keys / "ada.pem", keys / "ada.key", keys).hosts()
    with pytest.raises(InvalidConfig, match="No such file"):
        PageTls(tmp_path / "a.pem", tmp_path / "a.key", keys).hosts()
    (tmp_path / "room.key").write_bytes((keys / "room.key").read_bytes())
    (tmp_path / "room.key").chmod(0o644)
    with pytest.raises(InvalidConfig, match="chmod 600"):
        PageTls(keys / "room.pem", tmp_path / "room.key", keys).settings()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--expose"], "--expose needs --page-certificate"),
        (["--page-certificate", "a.pem"], "need --keys"),
        (["--page-key", "a.key"], "--page-key needs"),
    ],
)
def test_room__options_of_a_network_need_each_other(options: list[str], text: str) -> None:
    done = CliRunner().invoke(app, ["room", "--operator", "ada", *options])
    assert isinstance(done.exception, InvalidConfig)
    assert text in str(done.exception)


@pytest.fixture(scope="module")
def room(module_folder: Path, keys: Path) -> Iterator[Any]:
    """A control room with TLS on a bus with keys, whose node is a paused tank."""
    settings = {"plant": TANK, "name": "tank", "keys": str(keys)}
    settings["listen"] = [f"tls/127.0.0.1:{free_port()}"]
    with (
        NodeProgram(module_folder / "node", **settings) as node,
        zenostat.connect(node.endpoint, affinity="off", keys=keys, role=Role.OPERATOR) as bus,
        control_room(
            node.endpoint, keys=keys, role=Role.GATEWAY, tls=PageTls(keys / "room.pem", keys / "room.key", keys)
        ) as server,
    ):
        bus.pause("tank")
        server.bus = bus
        yield server


def client(room: Any, keys: Path, name: str) -> httpx.Client:
    """A browser with the certificate of a name; "" for none."""
    context = ssl.create_default_context(cafile=str(keys / "ca.pem"))
    if name:
        context.load_cert_chain(keys / f"{name}.pem", keys / f"{name}.key")
    port = room.url.rpartition(":")[2]
    url = f"https://127.0.0.1:{port}"
    return httpx.Client(base_url=url, verify=context, headers={"origin": url}, timeout=60)


@pytest.mark.slow
@pytest.mark.process
def test_room__operator_with_a_certificate_writes_under_its_name(room: Any, keys: Path) -> None:
    with client(room, keys, "ada") as ada:
        assert ada.get("/api/session").json()["operator"] == "ada"
        until(lambda: ada.get("/api/nodes/tank").status_code == 200, "the node has answered")
        assert ada.post("/api/nodes/tank/write", json={"point": "pump", "value": 20}).status_code == 200
        assert room.bus.priorities("tank")["pump"][7].source == "gateway.ada"
        (entry,) = [each for each in ada.get("/api/audit").json()["entries"] if each["operation"] == "write"]
        assert (entry["operator"], entry["target"], entry["accepted"]) == ("ada", "tank", True)
        with pytest.raises(httpx.HTTPError):  # plain HTTP at the same port
            httpx.get(str(ada.base_url).replace("https", "http"), headers={"host": ada.base_url.netloc.decode()})
    with client(room, keys, "wall") as wall:
        assert wall.get("/api/nodes/tank").status_code == 200
        assert wall.post("/api/nodes/tank/write", json={"point": "pump", "value": 1}).status_code == 403
        assert wall.get("/api/audit").status_code == 403
        assert wall.post("/api/invitation", json={"operator": "eve"}).status_code == 403
        assert wall.post("/api/nodes/tank/pause", json={}, headers={"origin": "https://evil.example"}).is_client_error
    with client(room, keys, "ada") as ada:
        entries = [each for each in ada.get("/api/audit").json()["entries"] if each["operator"] == "wall"]
    refused = "wall may only read; changes need an operator"
    assert [tuple(each[key] for key in ("operation", "target", "accepted", "outcome")) for each in entries[-3:]] == [
        ("write", "tank", False, refused),
        ("GET /api/audit", "", False, "wall may not read this; it is for operators"),
        ("POST /api/invitation", "", False, refused),
    ]


@pytest.mark.slow
@pytest.mark.process
def test_room__browser_without_a_certificate_signs_in_by_a_link(room: Any, keys: Path) -> None:
    with client(room, keys, "") as browser:
        assert browser.get("/api/nodes/tank").status_code == 401
        token = room.room.link("wall").partition("#token=")[2]
        answer = browser.post("/api/session", json={"token": token})
        assert answer.json() == {"operator": "wall"}
        cookie = answer.headers["set-cookie"]
        assert cookie.startswith("__Host-")
        assert {"Secure", "HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
        assert browser.get("/api/session").json()["role"] == "monitor"
        assert browser.post("/api/nodes/tank/pause", json={}).status_code == 403


@pytest.mark.slow
@pytest.mark.process
def test_room__certificate_of_another_authority_is_refused(room: Any, keys: Path, tmp_path: Path) -> None:
    certificates.make(tmp_path / "others")
    certificates.add(tmp_path / "others", Role.OPERATOR, "ada")
    context = ssl.create_default_context(cafile=str(keys / "ca.pem"))
    context.load_cert_chain(tmp_path / "others" / "ada.pem", tmp_path / "others" / "ada.key")
    with httpx.Client(verify=context) as stranger, pytest.raises(httpx.TransportError):
        stranger.get(f"https://127.0.0.1:{room.url.rpartition(':')[2]}/api/session")


@pytest.mark.slow
@pytest.mark.process
def test_room__stream_ends_when_its_user_is_revoked(room: Any, keys: Path) -> None:
    with client(room, keys, "eve") as eve, eve.stream("GET", "/api/stream?node=tank") as stream:
        lines = stream.iter_lines()
        assert next(line for line in lines if line.startswith("data: "))
        revoke(keys, "eve")
        assert list(lines) is not None  # it ends
    with client(room, keys, "eve") as eve:
        assert eve.get("/api/session").json()["operator"] is None


@pytest.mark.slow
@pytest.mark.process
def test_room__stream_ends_when_the_certificate_of_its_user_expires(
    room: Any, keys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with client(room, keys, "wall") as wall, wall.stream("GET", "/api/stream?node=tank") as stream:
        lines = stream.iter_lines()
        assert next(line for line in lines if line.startswith("data: "))
        monkeypatch.setattr(users, "time", SimpleNamespace(time=lambda: NEVER_S))
        assert list(lines) is not None  # it ends
        assert wall.get("/api/nodes/tank").status_code == 401


@pytest.mark.slow
@pytest.mark.process
@NEEDS_CHROMIUM
def test_room__real_browser_with_a_certificate_opens_the_page_and_changes_the_node(room: Any, keys: Path) -> None:
    pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    port = room.url.rpartition(":")[2]
    url = f"https://localhost:{port}"
    with chromium() as browser:
        files = {"certPath": str(keys / "ada.pem"), "keyPath": str(keys / "ada.key"), "origin": url}
        context = browser.new_context(ignore_https_errors=True, client_certificates=[files])
        page = context.new_page()
        complaints: list[str] = []
        page.on("console", lambda message: complaints.append(message.text))
        page.goto(f"{url}/?node=tank&table=points")
        page.get_by_role("button", name="Pump", exact=True).click()
        page.locator("#override").fill("50")
        page.get_by_role("button", name="Override", exact=True).click()
        page.locator(".drawer tr.effective", has_text="ada").wait_for()
        assert complaints == []
        assert json.loads(page.evaluate("fetch('/api/session').then(r => r.text())"))["operator"] == "ada"
        context.close()
