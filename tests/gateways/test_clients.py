"""Names of a gateway's clients, and what each may write."""

import re
from pathlib import Path
from zlib import crc32

import pytest

from zenostat.gateways.clients import UNRESTRICTED, Clients, read_clients
from zenostat.topics.errors import AccessDenied, InvalidConfig
from zenostat.topics.keys import is_name

TOKEN = "0123456789abcdef"
FILE = f"""\
clients:
  panel:
    mqtt: panel-user
    modbus: {{unit: 5, address: 192.168.1.20}}
    bacnet: {{instance: 1234}}
    boptest: {TOKEN}
    allow: ["core_*_setpoint"]
  plant:
    modbus: {{address: 192.168.2.0/24}}
    bacnet: {{address: 192.168.2.0/24}}
    allow: ["*"]
  display:
    modbus: {{unit: 9}}
"""


def _written(folder: Path, text: str, mode: int = 0o600) -> Path:
    path = folder / "clients.yaml"
    path.write_text(text)
    path.chmod(mode)
    return path


@pytest.fixture
def clients(tmp_path: Path) -> Clients:
    return read_clients(_written(tmp_path, FILE), [], is_exposed=True)


def test_clients__names_follow_from_what_each_protocol_knows(clients: Clients) -> None:
    assert clients.of_mqtt("panel-user") == "panel"
    assert clients.of_mqtt("panel") == ""
    assert clients.of_boptest(TOKEN) == "panel"
    assert clients.of_boptest(TOKEN + "0") == clients.of_boptest("") == ""
    assert clients.of_modbus("192.168.1.20", 5) == "panel"
    assert clients.of_modbus("192.168.1.21", 5) == clients.of_modbus("192.168.1.20", 6) == ""
    assert clients.of_modbus("192.168.2.77", 5) == "plant"
    assert clients.of_modbus("::ffff:10.0.0.1", 9) == "display"
    assert clients.of_bacnet("10.0.0.1", 1234) == "panel"
    assert clients.of_bacnet("10.0.0.1", None) == clients.of_bacnet("10.0.0.1", 1) == ""
    assert clients.of_bacnet("192.168.2.1", None) == "plant"
    assert clients.of_bacnet("2:0x0a", 7) == ""  # behind a router, where an address is no IP address
    assert clients.bacnet_instances == {1234}


def test_clients__each_writes_what_its_name_permits_and_nothing_else(clients: Clients) -> None:
    assert clients.denial("panel", "core_zn_cooling_setpoint") == ""
    assert clients.denial("panel", "perimeter_cooling_setpoint") == (
        "panel may not write perimeter_cooling_setpoint; it may write core_*_setpoint"
    )
    assert clients.denial("plant", "node/advance") == ""
    assert clients.denial("display", "core_zn_cooling_setpoint").endswith("it may write nothing")
    assert clients.denial("", "core_zn_cooling_setpoint").startswith(
        "a client that neither --clients nor --allow names"
    )
    assert clients.denial("panel", "*") == (
        "panel may not make this request, for which it must be allowed '*'; it may write core_*_setpoint"
    )
    with pytest.raises(AccessDenied, match="may not write b"):
        clients.check("panel", ["core_zn_cooling_setpoint", "b"])
    assert (clients.may_write("panel"), clients.may_write("display"), clients.may_write("")) == (True, False, False)
    assert clients.description == "panel, plant may write"


def test_allow__adds_to_the_file_and_names_everyone_with_a_star(tmp_path: Path) -> None:
    file = _written(tmp_path, FILE)
    clients = read_clients(file, ["display=perimeter_*", "*=blinds"], is_exposed=False)
    assert clients.denial("display", "perimeter_a") == clients.denial("", "blinds") == clients.denial("panel", "blinds")
    assert clients.denial("", "blinds") == ""
    assert clients.denial("", "perimeter_a")


def test_clients__request_on_no_single_point_needs_the_pattern_of_all() -> None:
    clients = read_clients(None, ["one=?", "two=[*]", "three=**", "all=*"], is_exposed=True, name_themselves=True)
    assert [name for name in clients.allowed if not clients.denial(name, "*")] == ["all"]


def test_clients__default_is_everything_on_loopback_and_nothing_over_a_network() -> None:
    assert read_clients(None, [], is_exposed=False) == UNRESTRICTED
    assert UNRESTRICTED.denial("", "any") == ""
    exposed = read_clients(None, [], is_exposed=True)
    assert exposed.is_read_only
    assert exposed.description == "read-only"
    assert exposed.denial("", "any")
    everybody = read_clients(None, ["*=*"], is_exposed=True)
    assert not everybody.is_read_only
    assert everybody.denial("", "any") == ""


def test_clients__users_name_themselves_where_there_is_no_file() -> None:
    assert UNRESTRICTED.of_mqtt("wall-panel_2") == "wall-panel_2"
    assert UNRESTRICTED.of_mqtt("Panel.7/x") == f"panel_7_x_{crc32(b'Panel.7/x'):08x}"  # one part of a source
    odd = ["", ".", "-", "ü", "*", "a b", "a.b", "a/b", "a_b", "A_b", "x", "u" * 64, "u" * 65, "u" * 66]
    names = {UNRESTRICTED.of_mqtt(user) for user in odd}
    assert len(names) == len(odd)
    assert all(is_name(name) and len(name) <= 64 for name in names)
    clients = read_clients(None, ["panel=core_*"], is_exposed=False, name_themselves=True)
    assert (clients.of_mqtt("panel"), clients.of_mqtt("other")) == ("panel", "")
    assert (clients.of_sender("panel.screen"), clients.of_sender("panels")) == ("panel", "")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("clients: {}", r"clients.yaml:1: clients: "),
        ("clients:\n  panel:\n    modbus: {}\n", r":3: clients.panel.modbus: expected address or unit, or both"),
        ("clients:\n  panel:\n    modbus: {unit: 256}\n", r":3: clients.panel.modbus.unit: .*255, got 256"),
        ("clients:\n  panel:\n    bacnet: {address: 10.0.0.1/8}\n", r":3: .*host bits set; expected an IP address"),
        ("clients:\n  panel:\n    allows: [a]\n", r":3: clients.panel.allows: there is no such field; .*allow"),
        ("clients:\n  a.b:\n    allow: [a]\n", r":2: clients.a.b"),
        ("clients:\n  a: {modbus: {unit: 1}}\n  b: {modbus: {unit: 1}}\n", r":3: clients.b.modbus: a has the same"),
        ("clients:\n  a:\n    boptest: secret\n", r":3: clients.a.boptest: expected a token of 16 to 512 ASCII"),
    ],
)
def test_clients__errors_of_the_file_have_its_lines(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InvalidConfig) as error:
        read_clients(_written(tmp_path, text), [], is_exposed=False)
    assert re.search(expected, str(error.value)), error.value
    assert "secret" not in str(error.value)


def test_clients__file_with_tokens_is_for_its_owner_alone(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"others may read it \(mode 640\): chmod 600"):
        read_clients(_written(tmp_path, FILE, 0o640), [], is_exposed=False)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("panel", "expected NAME=PATTERN"),
        ("=x", "expected NAME=PATTERN"),
        ("panel=", "expected NAME=PATTERN"),
        ("panel=x", r"is not a client in a file of clients \(--clients\)"),
    ],
)
def test_allow__bad_entries_have_one_error(text: str, expected: str) -> None:
    with pytest.raises(InvalidConfig, match=expected):
        read_clients(None, [text], is_exposed=False)


def test_allow__name_that_the_file_lacks_is_refused_with_similar_ones(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"'pannel' is not a client in .*panel"):
        read_clients(_written(tmp_path, FILE), ["pannel=x"], is_exposed=False, name_themselves=True)
