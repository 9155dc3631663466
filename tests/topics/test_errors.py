"""The tree of errors: drawn as it is, across process borders, with words that help."""

import errno
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenostat.bridge.transport.session import DEFAULT_ENDPOINT, check_endpoint, open_session
from zenostat.topics import errors
from zenostat.topics.errors import (
    AddressInUse,
    ErrorCollector,
    InvalidConfig,
    NodeNotFound,
    RequestRejected,
    UsageError,
    ZenostatError,
    did_you_mean,
    from_wire,
    repeated,
    to_wire,
)


def tree(cls: type[ZenostatError] = ZenostatError, depth: int = 0) -> Iterator[tuple[int, type[ZenostatError]]]:
    """The classes of `zenostat.topics.errors` in the order in which they are written, with their depth."""
    if cls.__module__ == errors.__name__:
        yield depth, cls
        for child in cls.__subclasses__():
            yield from tree(child, depth + 1)


ALL = [cls for _, cls in tree()]


def test_errors__tree_is_as_drawn() -> None:
    assert errors.__doc__ is not None
    drawn = [
        (match.start(1) // 4 - 1, match[1])
        for line in errors.__doc__.splitlines()
        if (match := re.match(r"[ │├└─]{4,}([A-Z]\w+)", line))
    ]
    assert drawn == [(depth, cls.__name__) for depth, cls in tree()]


@pytest.mark.parametrize("cls", ALL, ids=lambda c: c.__name__)
def test_errors__error_crosses_a_process_border_as_itself(cls: type[ZenostatError]) -> None:
    arrived = from_wire(to_wire(cls("what, where and what would have been right")))
    assert type(arrived) is cls
    assert str(arrived) == "what, where and what would have been right"


def test_errors__strangers_exception_keeps_its_types_name() -> None:
    arrived = from_wire(to_wire(KeyError("x")))
    assert type(arrived) is ZenostatError
    assert str(arrived) == "KeyError: 'x'"


@pytest.mark.parametrize(
    ("fields", "text"),
    [({}, "no reason given"), ({"error": "Later", "message": "of a later version"}, "of a later version")],
)
def test_errors__what_is_not_known_arrives_as_the_root(fields: dict[str, str], text: str) -> None:
    arrived = from_wire(fields)
    assert type(arrived) is ZenostatError
    assert str(arrived) == text


def test_from_wire__creates_no_class_of_the_interpreter() -> None:
    assert type(from_wire({"error": "SystemExit", "message": "1"})) is ZenostatError


def test_errors__one_except_catches_all() -> None:
    with pytest.raises(ZenostatError):
        raise RequestRejected("no")


# Similar names

SETPOINTS = ["core_zn_cooling_setpoint", "core_zn_heating_setpoint", "attic_cooling_setpoint", "lights"]


def test_errors__plural_comes_before_names_that_contain_the_text() -> None:
    names = ["DaylightingDevice:LightWell", "Exterior:Lights", "Lights"]
    assert did_you_mean("Light", names).startswith("did you mean 'Lights', 'DaylightingDevice:LightWell'")


def test_errors__names_that_contain_the_text_come_first() -> None:
    suggestion = did_you_mean("cooling", [*SETPOINTS, "coooling", "coling"])
    assert suggestion.startswith("did you mean 'core_zn_cooling_setpoint', 'attic_cooling_setpoint', 'coooling'")
    assert suggestion.endswith(" or 'coling'?")


def test_errors__names_that_are_spelled_alike_are_near() -> None:
    assert did_you_mean("ligths", SETPOINTS) == "did you mean 'lights'?"
    assert did_you_mean("LIGHTS", SETPOINTS) == "did you mean 'lights'?"


TYPES = ["Fan:ZoneExhaust", "ZoneEarthtube", "ZoneList", "Zone", "HVACTemplate:Thermostat", "Version"]


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("Zonee", "'Zone'"),
        ("zone", "'Zone'"),
        ("ZONE", "'Zone'"),
        ("Zoen", "'Zone'"),
        ("thermostat", "'HVACTemplate:Thermostat'"),
        ("vresion", "'Version'"),
    ],
)
def test_errors__typo_and_another_case_are_nearer_than_a_part_of_a_word(name: str, nearest: str) -> None:
    assert did_you_mean(name, TYPES).startswith(f"did you mean {nearest}")


@pytest.mark.parametrize(
    "name", ["Zone Air Temperature 4711x", "zone air temperature 4711", "oZne Air Temperature 4711"]
)
def test_errors__of_very_many_names_a_typo_at_any_place_finds_the_right_one(name: str) -> None:
    known = [f"{kind} {number}" for number in range(5000) for kind in ("Zone Air Temperature", "Node Mass Flow Rate")]
    assert did_you_mean(name, known).startswith("did you mean 'Zone Air Temperature 4711'")


def test_errors__where_nothing_is_near_some_are_shown() -> None:
    assert did_you_mean("qqq", SETPOINTS, limit=2) == (
        "there are: 'core_zn_cooling_setpoint', 'core_zn_heating_setpoint' and 2 more"
    )
    assert did_you_mean("", ["a", "b"]) == "there are: 'a', 'b'"


def test_errors__where_there_is_nothing_it_is_reported() -> None:
    assert did_you_mean("x", []) == "there are none"


@given(st.text(max_size=8), st.lists(st.text(max_size=8), max_size=12), st.integers(1, 5))
def test_errors__only_known_names_are_offered_and_never_too_many(name: str, known: list[str], most: int) -> None:
    suggestion = did_you_mean(name, iter(known), limit=most)
    if not known:
        assert suggestion == "there are none"
        return
    prefix = next(prefix for prefix in ("did you mean ", "there are: ") if suggestion.startswith(prefix))
    rest = suggestion.removeprefix(prefix)
    if prefix == "did you mean ":
        assert rest.endswith("?")
        rest = rest[:-1]
    offered = [n for n in dict.fromkeys(known) if repr(n) in rest]
    assert offered
    # Each offer is a known name in full, one after the other.
    text = re.sub(r" and \d+ more$", "", rest)
    shown = 0
    while text:
        fits = max((repr(n) for n in known if text.startswith(repr(n))), key=len)
        text = text[len(fits) :].removeprefix(", ").removeprefix(" or ")
        shown += 1
    assert shown <= most


@given(st.sampled_from(SETPOINTS))
def test_errors__name_is_nearest_to_itself(name: str) -> None:
    assert did_you_mean(name, SETPOINTS).startswith(f"did you mean {name!r}")


# Mistakes of this side are told before anything is started


@pytest.mark.parametrize("endpoint", [DEFAULT_ENDPOINT, "tcp/[::1]:7447", "tcp/localhost:0", "unixsock-stream/run/z"])
def test_errors__endpoint_is_taken(endpoint: str) -> None:
    assert check_endpoint(endpoint) == endpoint


@pytest.mark.parametrize(
    "endpoint",
    ["", "127.0.0.1:7447", "tcp/", "tcp:127.0.0.1:7447", "udp/127.0.0.1:1", "tcp/a b", "tcp/localhost", "tcp/a:99999"],
)
def test_errors__what_is_no_endpoint_is_refused_with_the_form(endpoint: str) -> None:
    with pytest.raises(InvalidConfig, match="write tcp/HOST:PORT") as raised:
        check_endpoint(endpoint)
    assert repr(endpoint) in str(raised.value)
    with pytest.raises(InvalidConfig):
        open_session(connect=[endpoint])


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.2:7447", "tcp/127.0.0.1.example.org:7447",
        "tcp/localhost.example.org:7447", "tcp/127.0.0.1:7447#iface=eth0",
    ],
)  # fmt: skip
def test_open_session__listens_to_other_machines_only_with_the_option(endpoint: str) -> None:
    with pytest.raises(UsageError, match="can be reached from other machines"):
        open_session(listen=[endpoint])


@pytest.mark.variants
@pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_UNIX])
def test_silent_program__has_an_error_of_its_own(family: int, tmp_path: Path) -> None:
    path = str(tmp_path / "bus")
    with socket.socket(family) as silent:
        silent.bind(path if family == socket.AF_UNIX else ("127.0.0.1", 0))
        silent.listen()
        address = path if family == socket.AF_UNIX else f"127.0.0.1:{silent.getsockname()[1]}"
        endpoint = f"{'unixsock-stream' if family == socket.AF_UNIX else 'tcp'}/{address}"
        with pytest.raises(NodeNotFound, match=rf"a program listens on {re.escape(endpoint)}, but does not answer"):
            open_session(connect=[endpoint])
    with pytest.raises(NodeNotFound, match=rf"nobody listens on {re.escape(endpoint)}; start a node there"):
        open_session(connect=[endpoint])


@pytest.mark.parametrize(
    ("failure", "text"),
    [(OSError(errno.EHOSTUNREACH, "No route to host"), "No route to host"), (TimeoutError("timed out"), "timed out")],
)
def test_errors__address_that_cannot_be_reached_is_not_one_where_nobody_listens(
    failure: OSError, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise failure

    monkeypatch.setattr(socket, "create_connection", fail)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(
            NodeNotFound, match=rf"no connection to {re.escape(endpoint)} \({text}\); check the address"
        ):
            open_session(connect=[endpoint])


def test_errors__path_of_a_unix_socket_is_not_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "bus"
    path.write_text("")
    with pytest.raises(AddressInUse, match="already exists"):
        open_session(listen=[f"unixsock-stream/{path}"])


def test_repeated__names_each_item_that_occurs_twice_once_in_their_order() -> None:
    assert repeated(["b", "a", "c", "a", "b", "a"]) == ["b", "a"]
    assert repeated({"a": 1, "b": "c"}) == []


def test_error_collector__reports_all_errors_and_equal_ones_once() -> None:
    def fail(text: str) -> None:
        raise InvalidConfig(text)

    collector = ErrorCollector()
    for text in ("no cache", "no weather", "no cache"):
        collector.collect(lambda text=text: fail(text))
    with pytest.raises(InvalidConfig) as error:
        collector.raise_if_any()
    assert str(error.value).splitlines() == ["no cache", "no weather"]
