"""Options of gateways that are not possible: one error before anything starts, for all protocols."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.nodes import NodeProgram
from support.run_cli import run_in_process

PLANT = f"{Path(__file__).parents[2]}/examples/own_plant.py:HeatPumpRoom"


@pytest.fixture(scope="module")
def office(module_folder: Path) -> Iterator[NodeProgram]:
    """A node `office` whose plant is a Python class: it starts within a second."""
    with NodeProgram(module_folder / "office", plant=PLANT, name="office") as program:
        yield program


@pytest.mark.parametrize(
    ("protocol", "options", "text"),
    [
        ("bacnet", ("office", "--address", "192.0.2.77:47808"), "--expose"),
        ("bacnet", ("office", "--address", "[::1]:47808"), "BACnet/IP needs an IPv4 address"),
        ("bacnet", ("office", "--address", "127.0.0.1:0"), "port 0 is not possible"),
        ("bacnet", ("office", "--address", "somewhere:47808"), "is not an address to listen on"),
        ("bacnet", ("office", "--source", "x" * 101), "101 characters"),
        ("bacnet", ("nobody",), "'nobody'"),
        ("fmi", ("nobody",), "'nobody'"),
        ("modbus", ("office", "--address", "0.0.0.0:1502"), "--expose"),
        ("modbus", ("office", "--address", "here:1502"), "write ADDRESS:PORT"),
        ("modbus", ("office", "--address", "127.0.0.1:99999"), "write ADDRESS:PORT"),
        ("modbus", ("office", "--word-order", "middle"), "expected big or little"),
        ("modbus", ("office", "--map", "map.xlsx"), ".csv or .md"),
        ("modbus", ("ofice",), "did you mean 'office'"),
        (
            "mqtt",
            ("office", "--broker", "127.0.0.1:1", "--source", "other"),
            "no connection to the MQTT broker 127.0.0.1:1",
        ),
        ("mqtt", ("office", "--broker", "broker.example"), "--tls"),
        ("mqtt", ("office", "--broker", "127.0.0.1:x"), "expected HOST:PORT"),
        ("mqtt", ("office", "--topic", "a/+/b"), "without wildcards"),
        ("mqtt", ("office", "--topic", "x" * 70_000), "at most 1000"),
        ("mqtt", ("office", "--topic", "$SYS/office"), "begin with '$'"),
        ("mqtt", ("office", "--source", ""), "is not valid in a topic"),
        ("mqtt", ("office", "--source", "x" * 129), "is not valid in a topic"),
        ("mqtt", ("office", "--ca", "nothing.pem"), "--ca needs --tls"),
        ("mqtt", ("office", "--tls", "--ca", "nothing.pem"), "no such file"),
        ("mqtt", ("office", "--tls", "--broker-key", "/dev/null"), "no such file"),
        ("mqtt", ("office", "--tls", "--broker-key", __file__), "--broker-key needs --broker-certificate"),
        ("mqtt", ("office", "--password-file", "/dev/null"), "--password-file /dev/null needs --username"),
        (
            "mqtt",
            ("office", "--username", "u", "--password-file", "/dev/null"),
            "--password-file /dev/null: the file is empty",
        ),
        ("mqtt", ("office", "--tls", "--ca", __file__), f"{__file__} is no CA certificate (PEM)"),
        ("mqtt", ("office", "--tls", "--broker-certificate", __file__), f"{__file__}: no certificate and its key"),
        ("mqtt", ("office", "--mqtt-version", "4"), "expected 5 or 3.1.1"),
        ("zeromq", ("--publish", "tcp://0.0.0.0:5556"), "can be reached from other machines"),
        ("zeromq", ("--command", "tcp/127.0.0.1:5557"), "is not a ZeroMQ endpoint"),
        ("zeromq", ("--node", "nobody"), "no node 'nobody'"),
        ("zeromq", ("--lease", "0"), "a lease of 0.0 s"),
        ("zeromq", ("--connect", "tcp/127.0.0.1:1"), "nobody listens on"),
    ],
)
def test_gateways__bad_options_have_one_error(
    office: NodeProgram, protocol: str, options: tuple[str, ...], text: str
) -> None:
    if protocol == "zeromq":
        pytest.importorskip("zmq", reason="pyzmq is not installed")
    done = run_in_process("gateway", protocol, "--connect", office.endpoint, *options, columns=500)
    assert done.returncode in (1, 2)
    *notes, error = done.stderr.splitlines()
    assert text in error
    assert all(note.startswith(("read-only: ", "BACnet/IP has no authentication: ")) for note in notes)
