"""Folders of keys: what is made, what is refused, and what OpenSSL thinks of it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from support.certificates import expire

from zenostat.bridge.transport import certificates
from zenostat.bridge.transport.certificates import add, identity, make, show
from zenostat.topics.errors import InvalidConfig, UnknownName
from zenostat.topics.keys import Role

ZENOSTAT = [sys.executable, "-P", "-m", "zenostat.cli.main"]
ROLES = ("node", "controller", "monitor")


@pytest.fixture
def made(tmp_path: Path) -> Path:
    make(tmp_path / "keys")
    return tmp_path / "keys"


def openssl(*arguments: object) -> subprocess.CompletedProcess[str]:
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl program here")
    return subprocess.run(["openssl", *map(str, arguments)], capture_output=True, text=True)


def test_a_folder_has_an_authority_and_a_certificate_for_each_role(made: Path) -> None:
    names = {"ca", *ROLES}
    assert {path.name for path in made.iterdir()} == {f"{name}.{kind}" for name in names for kind in ("pem", "key")}
    assert [(one.name, one.role, one.fault) for one in show(made)] == [
        ("ca", None, ""), *((role, Role(role), "") for role in ROLES),
    ]  # fmt: skip


def test_keys_can_be_read_by_their_owner_alone(made: Path) -> None:
    assert {path.stat().st_mode & 0o777 for path in made.glob("*.key")} == {0o600}
    assert made.stat().st_mode & 0o777 == 0o700


def test_validity_is_the_days_that_were_asked_for(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    by_name = {one.name: one.expires for one in make(tmp_path, days=30)}
    for role in ROLES:
        assert abs(by_name[role] - now - timedelta(days=30)) < timedelta(minutes=2)
    assert by_name["ca"] > now + timedelta(days=3649)


@pytest.mark.parametrize("role", ROLES)
def test_openssl_finds_the_chain_and_only_a_node_may_listen(made: Path, role: str) -> None:
    def verify(purpose: str) -> int:
        return openssl("verify", "-CAfile", made / "ca.pem", "-purpose", purpose, made / f"{role}.pem").returncode

    assert verify("sslclient") == 0
    assert (verify("sslserver") == 0) == (role == "node")


def test_openssl_reads_the_role_the_name_and_the_hosts(made: Path) -> None:
    add(made, Role.NODE, "annex", hosts=["lab.example.org", "192.168.1.20", "fe80::1"])
    text = openssl("x509", "-in", made / "annex.pem", "-noout", "-text").stdout
    assert "CN = zenostat-node, OU = annex" in text or "CN=zenostat-node, OU=annex" in text
    for host in ("DNS:localhost", "IP Address:127.0.0.1", "DNS:lab.example.org", "IP Address:192.168.1.20"):
        assert host in text
    for host, answer in (("lab.example.org", "does match"), ("other.example.org", "does NOT match")):
        assert answer in openssl("x509", "-in", made / "annex.pem", "-noout", "-checkhost", host).stdout


def test_each_certificate_has_a_key_of_its_own(made: Path) -> None:
    assert len({path.read_bytes() for path in made.glob("*.key")}) == 4


def test_nothing_is_overwritten_unless_it_is_forced(made: Path) -> None:
    before = {path: path.read_bytes() for path in made.iterdir()}
    with pytest.raises(InvalidConfig, match=r"already has ca\.pem, ca\.key, node\.pem.*--force"):
        make(made)
    with pytest.raises(InvalidConfig, match=r"already has monitor\.pem, monitor\.key"):
        add(made, Role.MONITOR, "monitor")
    assert {path: path.read_bytes() for path in made.iterdir()} == before
    make(made, force=True)
    assert not set(before.values()) & {path.read_bytes() for path in made.iterdir()}


def test_a_key_is_never_written_into_a_file_that_others_may_read(made: Path) -> None:
    (made / "node.key").chmod(0o644)
    make(made, force=True)
    assert (made / "node.key").stat().st_mode & 0o777 == 0o600


def test_certificates_of_a_former_authority_are_named(made: Path) -> None:
    add(made, Role.CONTROLLER, "second")
    assert identity(made, Role.CONTROLLER, "second").key == made / "second.key"
    make(made, force=True)
    assert [one.name for one in show(made) if "another authority" in one.fault] == ["second"]
    with pytest.raises(InvalidConfig, match=r"another authority than ca\.pem"):
        identity(made, Role.CONTROLLER, "second")


def test_all_faults_of_a_call_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig) as raised:
        make(tmp_path / "keys", hosts=["a b", "-x.org", "300.1.1.1"], days=0)
    for said in ("'a b' is not a host", "'-x.org' is not a host", "'300.1.1.1' is not a host", "1 to 3650"):
        assert said in str(raised.value)
    assert not (tmp_path / "keys").exists()


@pytest.mark.parametrize(
    ("role", "name", "given", "said"),
    [
        (Role.CONTROLLER, "ca", {}, "is the name of the authority"),
        (Role.CONTROLLER, "../x", {}, "is not valid in a topic"),
        (Role.CONTROLLER, "x", {"hosts": ["h.org"]}, "does not listen"),
        (Role.ANYONE, "x", {}, "name one of node, controller, monitor"),
        (Role.NODE, "x", {"days": 4000}, "days of validity"),
    ],
)
def test_what_cannot_be_added_is_refused(made: Path, role: Role, name: str, given: dict, said: str) -> None:
    before = sorted(made.parent.rglob("*"))
    with pytest.raises(InvalidConfig, match=said):
        add(made, role, name, **given)
    assert sorted(made.parent.rglob("*")) == before


def test_adding_needs_the_authority_s_key(made: Path) -> None:
    (made / "ca.key").unlink()
    with pytest.raises(InvalidConfig, match=r"ca\.key; it is on the machine where the keys were created"):
        add(made, Role.CONTROLLER, "second")


# What a program shows on the bus


def test_a_program_needs_only_the_authority_s_certificate_and_its_own_files(made: Path) -> None:
    for other in ("ca.key", "node.pem", "node.key"):
        (made / other).unlink()
    found = identity(made, Role.CONTROLLER)
    assert (found.authority, found.certificate) == (made / "ca.pem", made / "controller.pem")


def test_a_certificate_that_is_not_there(made: Path) -> None:
    with pytest.raises(UnknownName, match=r"no certificate 'contoller'.*'controller'.*zenostat keys add controller"):
        identity(made, Role.CONTROLLER, "contoller")
    with pytest.raises(InvalidConfig, match="zenostat keys init"):
        identity(made / "nowhere", Role.NODE)


def test_an_expired_certificate(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expire(made, "late", monkeypatch)
    with pytest.raises(InvalidConfig, match=r"late\.pem: expired on .*zenostat keys add --force"):
        identity(made, Role.CONTROLLER, "late")


def test_a_certificate_of_the_morrow(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "_BACKDATED", timedelta(hours=-5))
    add(made, Role.CONTROLLER, "early")
    with pytest.raises(InvalidConfig, match=r"not valid before.*clock"):
        identity(made, Role.CONTROLLER, "early")


def test_all_faults_of_a_certificate_are_told_at_once(made: Path, tmp_path: Path) -> None:
    make(tmp_path / "other")
    for kind in ("pem", "key"):
        shutil.copy(tmp_path / "other" / f"monitor.{kind}", made / f"mine.{kind}")
    shutil.copy(made / "node.key", made / "mine.key")
    with pytest.raises(InvalidConfig) as raised:
        identity(made, Role.CONTROLLER, "mine")
    for said in ("another authority", "is of the role monitor; controller expected", "does not match the certificate"):
        assert said in str(raised.value)


def test_a_key_that_others_may_read(made: Path) -> None:
    (made / "monitor.key").chmod(0o640)
    with pytest.raises(InvalidConfig, match="chmod 600"):
        identity(made, Role.MONITOR)


@pytest.mark.parametrize("mode", [0o640, 0o604])
def test_an_authority_whose_key_others_may_read_is_named_and_makes_no_certificate(made: Path, mode: int) -> None:
    (made / "ca.key").chmod(mode)
    faults = {one.name: one.fault for one in show(made)}
    assert faults.pop("ca") == f"ca.key can be read by other users; restrict its permissions: chmod 600 {made}/ca.key"
    assert set(faults.values()) == {""}
    with pytest.raises(InvalidConfig, match=r"ca\.key can be read by other users; restrict its permissions: chmod 600"):
        add(made, Role.CONTROLLER, "annex")
    assert not (made / "annex.pem").exists()
    (made / "ca.key").chmod(0o600)
    assert add(made, Role.CONTROLLER, "annex").fault == ""


@pytest.mark.parametrize(
    ("name", "said"), [("monitor.pem", "is not a certificate"), ("monitor.key", "is not a private key")]
)
def test_a_file_of_something_else(made: Path, name: str, said: str) -> None:
    (made / name).write_text("hello")
    with pytest.raises(InvalidConfig, match=said):
        identity(made, Role.MONITOR)


# The command


@pytest.mark.slow
def test_the_command_makes_adds_and_shows(tmp_path: Path) -> None:
    def run_zenostat(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*ZENOSTAT, "keys", *arguments], capture_output=True, text=True, cwd=tmp_path)

    first = run_zenostat("init", "--host", "lab.example.org", "--days", "30")
    assert first.returncode == 0, first.stderr
    assert run_zenostat("add", "controller", "annex").returncode == 0
    shown = run_zenostat("show").stdout
    rows = [tuple(cell.strip() for cell in line.split("│")[1:3]) for line in shown.splitlines() if "│" in line]
    expected = [("authority", "ca"), ("node", "node"), ("controller", "annex"), ("controller", "controller")]
    assert [row for row in rows if row[1]] == [*expected, ("monitor", "monitor")]
    again = run_zenostat("init")
    assert again.returncode == 2
    assert "--force" in again.stderr
    assert run_zenostat("add", "owner", "x").returncode == 2
