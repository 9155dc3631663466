"""Hosts and ports in texts, and which hosts are this machine alone."""

import pytest

from zenostat.bridge.transport.session import exposure
from zenostat.topics.addresses import is_loopback, split_address

LOCAL = ("localhost", "127.0.0.1", "127.9.8.7", "[::1]", "[0:0:0:0:0:0:0:1]")
REACHABLE = ("0.0.0.0", "192.168.1.20", "[::]", "[fe80::1]", "127.0.0.1.example.org", "127.0.0.1,10.0.0.1", "building")


@pytest.mark.parametrize("host", LOCAL)
def test_is_loopback__of_this_machine(host: str) -> None:
    assert is_loopback(host)
    assert is_loopback(host.strip("[]"))
    assert not exposure([f"tcp/{host}:7447"], keys=None)


@pytest.mark.parametrize("host", REACHABLE)
def test_is_loopback__of_others(host: str) -> None:
    assert not is_loopback(host)
    assert exposure([f"tcp/{host}:7447"], keys=None)


def test_exposure__endpoint_with_options_is_assumed_to_be_reachable() -> None:
    assert exposure(["tcp/127.0.0.1:7447#iface=eth0"], keys=None)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("broker", ("broker", 1883)),
        ("broker:8883", ("broker", 8883)),
        ("10.0.0.1:0", ("10.0.0.1", 0)),
        ("[::1]", ("::1", 1883)),
        ("[::1]:65535", ("::1", 65535)),
        ("::1", None),
        ("broker:65536", None),
        ("broker:x", None),
        (":1883", None),
        ("tcp://broker:1883", None),
        ("a b", None),
        ("", None),
    ],
)
def test_split_address__takes_host_and_port(text: str, address: tuple[str, int] | None) -> None:
    assert split_address(text, 1883) == address
