"""Folders of keys: what is made, what is refused, and what OpenSSL thinks of it."""

import errno
import os
import re
import shutil
import subprocess
from codecs import BOM_UTF8
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.certificates import expire
from support.nodes import free_port
from support.run_cli import run_program

from zenostat.bridge.client.bus import connect
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.transport import certificates
from zenostat.bridge.transport.certificates import add, make
from zenostat.bridge.transport.deny_list import REVOKED, DenyList, read_revoked, revoke
from zenostat.bridge.transport.identity import expiry_warning, identity, names_of, show
from zenostat.bridge.transport.name_list import NAMES
from zenostat.bridge.transport.session import OpenSession, open_session
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.keys import Role

ROLES = ("node", "controller", "operator", "monitor", "gateway")
TRAINER = (Role.CONTROLLER, Role.OPERATOR)


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    make(tmp_path / "keys")
    return tmp_path / "keys"


def openssl(*arguments: object) -> subprocess.CompletedProcess[str]:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed; on Debian: apt install openssl")
    return subprocess.run(["openssl", *map(str, arguments)], capture_output=True, text=True)


def test_certificates__folder_has_an_authority_and_a_certificate_for_each_role(pki: Path) -> None:
    names = {"ca", *ROLES, "trainer"}
    files = {f"{name}.{kind}" for name in names for kind in ("pem", "key")}
    assert {path.name for path in pki.iterdir()} == {*files, "names.json"}
    assert [(one.name, one.roles, one.fault) for one in show(pki)] == [
        ("ca", (), ""), ("node", (Role.NODE,), ""), ("controller", (Role.CONTROLLER,), ""), ("trainer", TRAINER, ""),
        *((role, (Role(role),), "") for role in ROLES[2:]),
    ]  # fmt: skip
    assert identity(pki, Role.NODE).names() == {"trainer": TRAINER, **{role: (Role(role),) for role in ROLES}}


def test_certificates__keys_can_be_read_by_their_owner_alone(pki: Path) -> None:
    assert {path.stat().st_mode & 0o777 for path in pki.glob("*.key")} == {0o600}
    assert pki.stat().st_mode & 0o777 == 0o700


def test_certificate__is_valid_for_the_requested_days(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    by_name = {one.name: one.expires for one in make(tmp_path, days=30)}
    for role in ROLES:
        assert abs(by_name[role] - now - timedelta(days=30)) < timedelta(minutes=2)
    assert by_name["ca"] > now + timedelta(days=3649)


@pytest.mark.parametrize("role", ROLES)
def test_certificates__openssl_finds_the_chain_and_only_a_node_may_listen(pki: Path, role: str) -> None:
    def verify(purpose: str) -> int:
        return openssl("verify", "-CAfile", pki / "ca.pem", "-purpose", purpose, pki / f"{role}.pem").returncode

    assert verify("sslclient") == 0
    assert (verify("sslserver") == 0) == (role == "node")


def test_certificates__openssl_reads_the_role_the_name_and_the_hosts(pki: Path) -> None:
    add(pki, Role.NODE, "annex", hosts=["lab.example.org", "192.168.1.20", "fe80::1"])
    text = openssl("x509", "-in", pki / "annex.pem", "-noout", "-text").stdout
    assert "CN = annex, OU = node" in text or "CN=annex, OU=node" in text
    for host in ("DNS:localhost", "IP Address:127.0.0.1", "DNS:lab.example.org", "IP Address:192.168.1.20"):
        assert host in text
    for host, answer in (("lab.example.org", "does match"), ("other.example.org", "does NOT match")):
        assert answer in openssl("x509", "-in", pki / "annex.pem", "-noout", "-checkhost", host).stdout


def test_certificates__each_certificate_has_a_key_of_its_own(pki: Path) -> None:
    assert len({path.read_bytes() for path in pki.glob("*.key")}) == len(ROLES) + 2


def test_certificates__nothing_is_overwritten_unless_it_is_forced(pki: Path) -> None:
    before = {path: path.read_bytes() for path in pki.iterdir()}
    with pytest.raises(InvalidConfig, match=r"already has ca\.pem, ca\.key, node\.pem.*--force"):
        make(pki)
    with pytest.raises(InvalidConfig, match=r"already has monitor\.pem, monitor\.key"):
        add(pki, Role.MONITOR, "monitor")
    assert {path: path.read_bytes() for path in pki.iterdir()} == before
    make(pki, force=True)
    assert not set(before.values()) & {path.read_bytes() for path in pki.iterdir()}


def test_certificates__renewed_node_keeps_its_hosts(pki: Path) -> None:
    hosts = add(pki, Role.NODE, "node", hosts=["lab.example.org"], force=True).hosts
    assert "lab.example.org" in hosts
    assert add(pki, Role.NODE, "node", force=True).hosts == hosts
    assert "lab.example.org" not in add(pki, Role.NODE, "node", hosts=["other.example.org"], force=True).hosts


def test_certificates__other_files_in_the_folder_are_no_certificates(pki: Path) -> None:
    names = [certificate.name for certificate in show(pki)]
    (pki / "chain.pem").write_text("something else")
    assert [certificate.name for certificate in show(pki)] == names
    (pki / "monitor.pem").write_text("damaged")
    with pytest.raises(InvalidConfig, match=r"monitor.pem is not a certificate \(PEM\)"):
        show(pki)


def test_certificates__key_is_never_written_into_a_file_that_others_may_read(pki: Path) -> None:
    (pki / "node.key").chmod(0o644)
    make(pki, force=True)
    assert (pki / "node.key").stat().st_mode & 0o777 == 0o600


def test_certificates__of_a_former_authority_are_named(pki: Path) -> None:
    add(pki, Role.CONTROLLER, "second")
    assert identity(pki, Role.CONTROLLER, "second").key == pki / "second.key"
    make(pki, force=True)
    assert [one.name for one in show(pki) if "another authority" in one.fault] == ["second"]
    with pytest.raises(InvalidConfig, match=r"another authority than ca\.pem"):
        identity(pki, Role.CONTROLLER, "second")


def test_make__reports_all_errors_of_a_call_at_once(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig) as raised:
        make(tmp_path / "keys", hosts=["a b", "-x.org", "300.1.1.1"], days=0)
    for fault in ("'a b' is not a host", "'-x.org' is not a host", "'300.1.1.1' is not a host", "1 to 3650"):
        assert fault in str(raised.value)
    assert not (tmp_path / "keys").exists()


@pytest.mark.parametrize(
    ("role", "name", "arguments", "message"),
    [
        (Role.CONTROLLER, "ca", {}, "is the name of the authority"),
        (Role.CONTROLLER, "../x", {}, "is not valid in a topic"),
        (Role.CONTROLLER, "x", {"hosts": ["h.org"]}, "does not listen"),
        (Role.CONTROLLER, "x" * 65, {}, "at most 64"),
        (Role.CONTROLLER, "operator.x", {}, "a holder of the shorter name may send under the longer one"),
        ((), "x", {}, "no certificates for no role"),
        ((Role.NODE, Role.OPERATOR), "x", {}, "a node has no further role"),
        (Role.ANYONE, "x", {}, "name one of node, controller, operator, monitor, gateway"),
        (Role.NODE, "x", {"days": 4000}, "days of validity"),
    ],
)
def test_certificates__what_cannot_be_added_is_refused(
    pki: Path, role: Any, name: str, arguments: dict, message: str
) -> None:
    before = sorted(pki.parent.rglob("*"))
    with pytest.raises(InvalidConfig, match=message):
        add(pki, role, name, **arguments)
    assert sorted(pki.parent.rglob("*")) == before


def test_certificates__adding_needs_the_authority_s_key(pki: Path) -> None:
    (pki / "ca.key").unlink()
    with pytest.raises(InvalidConfig, match=r"ca\.key; it is on the machine where the keys were created"):
        add(pki, Role.CONTROLLER, "second")


# The list of names


def test_name_list__has_each_name_with_its_roles(pki: Path) -> None:
    add(pki, TRAINER, "ppo-7")
    names = identity(pki, Role.NODE).names()
    assert names["ppo-7"] == identity(pki, None, "ppo-7").roles == TRAINER
    add(pki, Role.MONITOR, "ppo-7", force=True)
    assert identity(pki, Role.NODE).names() == names | {"ppo-7": (Role.MONITOR,)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("monitor", "operator"), "is not signed by the authority"),
        (lambda text: re.sub(r'"monitor"(?!:)', '"owner"', text), "is not a list of names"),
        (lambda _: "[]", "is not a list of names"),
        (lambda _: "{", "is not a list of names"),
    ],
    ids=["changed", "unknown role", "no list", "no JSON"],
)
def test_name_list__change_by_anyone_but_the_authority_is_refused(
    pki: Path, change: Callable[[str], str], message: str
) -> None:
    (pki / "names.json").write_text(change((pki / "names.json").read_text()))
    with pytest.raises(InvalidConfig, match=message):
        identity(pki, Role.NODE).names()
    with pytest.raises(InvalidConfig, match=message):
        add(pki, Role.OPERATOR, "panel")


def test_name_list__of_another_authority_or_none_is_refused(pki: Path, tmp_path: Path) -> None:
    make(tmp_path / "other")
    shutil.copy(tmp_path / "other" / "names.json", pki / "names.json")
    with pytest.raises(InvalidConfig, match="is not signed by the authority"):
        identity(pki, Role.NODE).names()
    (pki / "names.json").unlink()
    with pytest.raises(InvalidConfig, match=r"copy this list .* from the folder where the keys were created"):
        identity(pki, Role.NODE).names()


# What a program shows on the bus


def test_certificates__program_needs_only_the_authority_s_certificate_and_its_own_files(pki: Path) -> None:
    for other in ("ca.key", "node.pem", "node.key", "names.json"):
        (pki / other).unlink()
    files = identity(pki, Role.CONTROLLER)
    assert (files.authority, files.certificate) == (pki / "ca.pem", pki / "controller.pem")


def test_certificates__certificate_that_is_not_there(pki: Path) -> None:
    with pytest.raises(
        UnknownName, match=r"no certificate 'contoller'.*'controller'.*zenostat keys add contoller --role controller"
    ):
        identity(pki, Role.CONTROLLER, "contoller")
    with pytest.raises(InvalidConfig, match="zenostat keys init"):
        identity(pki / "nowhere", Role.NODE)


@pytest.mark.parametrize("name", ["trainer", "gateway"])
def test_certificates__several_roles_need_a_certificate_of_all(pki: Path, name: str) -> None:
    """A gateway may send what a controller and an operator may."""
    assert identity(pki, TRAINER).certificate == pki / "trainer.pem"
    assert identity(pki, TRAINER, name).certificate == pki / f"{name}.pem"
    with pytest.raises(
        InvalidConfig, match=r"r\.pem is of the role operator; controller and operator expected, as tra"
    ):
        identity(pki, TRAINER, "operator")
    (pki / "trainer.pem").unlink()
    with pytest.raises(UnknownName, match="zenostat keys add trainer --role controller --role operator"):
        identity(pki, TRAINER)


def test_certificates__name_that_is_not_in_the_list_is_a_fault(tmp_path: Path) -> None:
    make(tmp_path)
    listed = (tmp_path / NAMES).read_bytes()
    add(tmp_path, Role.OPERATOR, "otherman")
    (tmp_path / NAMES).write_bytes(listed)
    faults = {each.name: each.fault for each in show(tmp_path)}
    assert faults.pop("otherman") == "'otherman' is not in names.json, so no node accepts it; add it: zenostat keys add"
    assert {*faults.values()} == {""}
    (tmp_path / NAMES).unlink()  # a program's own folder has none
    assert {each.fault for each in show(tmp_path)} == {""}


@pytest.mark.parametrize("name", ["a;b", "why?"])
def test_certificates__folder_that_zenoh_cannot_read_is_named(tmp_path: Path, name: str) -> None:
    make(tmp_path / name)
    with pytest.raises(InvalidConfig, match=re.escape(f"{tmp_path / name}: choose a path without ';' and '?'")):
        identity(tmp_path / name, Role.MONITOR)


def test_certificates__expired_certificate(pki: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expire(pki, "late", monkeypatch)
    remedy = "zenostat keys add NAME --role ROLE --force"
    with pytest.raises(InvalidConfig, match=rf"late\.pem: expired on \d{{4}}-\d\d-\d\d \d\d:\d\d UTC; .*{remedy}"):
        identity(pki, Role.CONTROLLER, "late")


def test_why_gone__says_that_the_own_certificate_has_expired_or_may_be_revoked(
    pki: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session: Any = None
    shown = identity(pki, Role.GATEWAY)
    may_be_revoked = ", or gateway is revoked or not in the list of names"
    assert OpenSession(session, shown).why_gone() == may_be_revoked
    expire(pki, "gateway", monkeypatch, Role.GATEWAY)
    past = replace(shown, expires=datetime.now(UTC) - timedelta(days=1))
    assert OpenSession(session, past).why_gone().startswith(f": {pki / 'gateway.pem'} expired on ")
    add(pki, Role.GATEWAY, "gateway", force=True)
    assert OpenSession(session, past).why_gone() == may_be_revoked
    assert OpenSession(session).why_gone() == ""


@pytest.mark.parametrize(("days", "left"), [(1, "23 h"), (2, "47 h"), (29, "28 days"), (31, "")])
def test_certificates__that_expire_within_30_days_are_warned_of(tmp_path: Path, days: int, left: str) -> None:
    warnings = {one.name: one.warning for one in make(tmp_path, days=days)}
    assert warnings["ca"] == ""
    certificate = identity(tmp_path, Role.MONITOR)
    remedy = "renew it with: zenostat keys add NAME --role ROLE --force"
    expected = f"expires on {certificate.expires:%Y-%m-%d %H:%M} UTC, in {left}; {remedy}"
    assert warnings["monitor"] == (expected if left else "")
    assert certificate.warning == (f"{certificate.certificate} {expected}" if left else "")


@pytest.mark.parametrize(("seconds", "left"), [(3900, "1 h"), (3000, "50 min"), (20, "1 min")])
def test_expiry_warning__counts_the_minutes_of_the_last_hour(seconds: float, left: str) -> None:
    assert f" UTC, in {left}; renew it" in expiry_warning(datetime.now(UTC) + timedelta(seconds=seconds))


def test_open_session__warns_of_a_certificate_that_expires_soon(tmp_path: Path) -> None:
    make(tmp_path, days=20)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    warned: list[str] = []
    with open_session(listen=[endpoint], keys=tmp_path, role=Role.NODE, warn=warned.append):
        assert warned == [identity(tmp_path, Role.NODE).warning]
        for opener in (
            lambda: open_session(connect=[endpoint], keys=tmp_path, role=Role.MONITOR),
            lambda: connect(endpoint, keys=tmp_path, role=Role.MONITOR, affinity=Affinity.OFF),
        ):
            with pytest.warns(UserWarning, match=r"monitor\.pem expires on .*, in 19 days") as caught, opener():
                pass
            assert [warning.filename for warning in caught] == [__file__]


def test_certificates__certificate_of_the_morrow(pki: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "_BACKDATED", timedelta(hours=-5))
    add(pki, Role.CONTROLLER, "early")
    with pytest.raises(InvalidConfig, match=r"not valid before.*clock"):
        identity(pki, Role.CONTROLLER, "early")


def test_identity__reports_all_errors_of_a_certificate_at_once(pki: Path, tmp_path: Path) -> None:
    make(tmp_path / "other")
    for kind in ("pem", "key"):
        shutil.copy(tmp_path / "other" / f"monitor.{kind}", pki / f"mine.{kind}")
    shutil.copy(pki / "node.key", pki / "mine.key")
    with pytest.raises(InvalidConfig) as raised:
        identity(pki, Role.CONTROLLER, "mine")
    for fault in ("another authority", "is of the role monitor; controller expected", "does not match the certificate"):
        assert fault in str(raised.value)


def test_certificates__key_that_others_may_read(pki: Path) -> None:
    (pki / "monitor.key").chmod(0o640)
    with pytest.raises(InvalidConfig, match="chmod 600"):
        identity(pki, Role.MONITOR)


@pytest.mark.parametrize("mode", [0o640, 0o604])
def test_certificates__authority_whose_key_others_may_read_is_named_and_makes_no_certificate(
    pki: Path, mode: int
) -> None:
    (pki / "ca.key").chmod(mode)
    faults = {one.name: one.fault for one in show(pki)}
    key = f"{pki}/ca.key"
    assert faults.pop("ca") == f"{key} can be read by other users; restrict its permissions: chmod 600 {key}"
    assert set(faults.values()) == {""}
    with pytest.raises(InvalidConfig, match=r"ca\.key can be read by other users; restrict its permissions: chmod 600"):
        add(pki, Role.CONTROLLER, "annex")
    assert not (pki / "annex.pem").exists()
    (pki / "ca.key").chmod(0o600)
    assert add(pki, Role.CONTROLLER, "annex").fault == ""


@pytest.mark.parametrize(
    ("name", "message"), [("monitor.pem", "is not a certificate"), ("monitor.key", "is not a private key")]
)
def test_certificates__file_of_something_else(pki: Path, name: str, message: str) -> None:
    (pki / name).write_text("hello")
    with pytest.raises(InvalidConfig, match=message):
        identity(pki, Role.MONITOR)


@pytest.mark.parametrize("name", ["ca.pem", "monitor.pem", "monitor.key"])
def test_certificates__file_with_a_byte_order_mark_is_named(pki: Path, name: str) -> None:
    """Zenoh reads no such file, and names none."""
    (pki / name).write_bytes(BOM_UTF8 + (pki / name).read_bytes())
    message = re.escape(f"{pki / name} begins with a byte order mark")
    with pytest.raises(InvalidConfig, match=message):
        identity(pki, Role.MONITOR)
    if name.endswith(".key"):
        assert [one.name for one in show(pki) if re.match(message, one.fault)] == ["monitor"]


def test_read_revoked__takes_a_file_with_a_byte_order_mark(pki: Path) -> None:
    (pki / REVOKED).write_bytes(BOM_UTF8 + b"monitor\r\n")
    assert read_revoked(pki) == {"monitor"}


@pytest.mark.parametrize("name", ["ca.pem", "monitor.pem", "monitor.key", "names.json"])
def test_certificates__file_that_cannot_be_read_is_not_reported_as_missing(
    pki: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def read_bytes(path: Path) -> bytes:
        if path.name == name:
            raise PermissionError(errno.EACCES, "Permission denied")
        return read(path)

    read = Path.read_bytes
    with monkeypatch.context() as patch:  # root may read every file
        patch.setattr(Path, "read_bytes", read_bytes)
        with pytest.raises(InvalidConfig, match=rf"^cannot read .*/{name}: Permission denied$"):
            identity(pki, Role.MONITOR).names()
    (pki / name).unlink()
    (pki / name).mkdir()
    with pytest.raises(InvalidConfig, match=rf"/{name} is a folder; expected a (PEM file|list of names)"):
        identity(pki, Role.MONITOR).names()


# Several programs


def test_certificates__names_that_are_added_and_revoked_at_the_same_time_are_all_kept(pki: Path) -> None:
    names = [f"agent-{number}" for number in range(10)]
    with ThreadPoolExecutor(20) as pool:
        added = [pool.submit(add, pki, Role.CONTROLLER, name) for name in names]
        revoked = [pool.submit(revoke, pki, name) for name in names]
        for future in (*added, *revoked):
            future.result()
    assert set(names) < set(names_of(pki))
    assert read_revoked(pki) == set(names)
    assert not [path.name for path in pki.iterdir() if path.name.startswith(".")]


def test_deny_list__name_that_its_file_no_longer_has_stays_revoked(pki: Path, folder: Path) -> None:
    errors: list[str] = []
    revoke(pki, "monitor")
    timer: Any = SimpleNamespace(at=lambda *_: None)
    with open_session(listen=[f"unixsock-stream/{folder}/bus"]) as session:
        deny_list = DenyList(pki, session, timer, lambda _: None, errors.append)
        (pki / REVOKED).write_text("gateway\n")
        deny_list._check()
        assert deny_list.names == {"monitor", "gateway"}
        (pki / REVOKED).unlink()
        deny_list._check()
        deny_list.close()
    assert deny_list.names == {"monitor", "gateway"}
    assert [error.partition("revoked.txt ")[2] for error in errors] == [
        "no longer has monitor",
        "no longer has gateway, monitor",
    ]


def test_certificates__lists_of_names_can_be_read_by_the_user_of_the_node(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        make(tmp_path)
        revoke(tmp_path, "monitor")
    finally:
        os.umask(before)
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in (NAMES, REVOKED, "ca.key")] == [0o644, 0o644, 0o600]


def test_deny_list__name_is_revoked_where_its_file_cannot_be_written(pki: Path, folder: Path) -> None:
    changes: list[frozenset[str]] = []
    timer: Any = SimpleNamespace(at=lambda *_: None)
    with open_session(listen=[f"unixsock-stream/{folder}/bus"]) as session:
        deny_list = DenyList(pki, session, timer, changes.append, pytest.fail)
        (pki / ".names.lock").mkdir()
        with pytest.raises(InvalidConfig, match=r"cannot create .*names\.lock: Is a directory"):
            deny_list.add("monitor")
        deny_list.close()
    assert (deny_list.names, changes) == ({"monitor"}, [{"monitor"}])


# The command


@pytest.mark.slow
def test_certificates__command_makes_adds_and_shows(tmp_path: Path) -> None:
    def run_zenostat(*arguments: str) -> subprocess.CompletedProcess[str]:
        return run_program("keys", *arguments, cwd=tmp_path)

    first = run_zenostat("init", "--host", "lab.example.org", "--days", "90")
    assert first.returncode == 0, first.stderr
    assert run_zenostat("add", "annex", "--role", "controller", "--role", "operator").returncode == 0
    shown = run_zenostat("show").stdout
    assert [tuple(re.split(" {2,}", line)[:2]) for line in shown.splitlines()] == [
        ("role", "name"),
        ("authority", "ca"),
        ("node", "node"),
        ("controller, operator", "annex"),
        ("controller", "controller"),
        ("controller, operator", "trainer"),
        ("operator", "operator"),
        ("monitor", "monitor"),
        ("gateway", "gateway"),
    ]
    again = run_zenostat("init")
    assert again.returncode == 2
    assert "--force" in again.stderr
    assert run_zenostat("add", "x", "--role", "owner").returncode == 2
