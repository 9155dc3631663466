"""Clients of gateways: their names, and the points that each may write.

A client of another protocol has no certificate. The user's file maps what its protocol knows of it (the user name of
MQTT, a token of BOPTEST, the device instance or address of BACnet, the unit id or address of Modbus, the address from
which an FMU connects) to a name, and the gateway sends for it under that name, below its own: `modbus.panel`. What a
client may write follows from its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from hashlib import sha256
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network
from pathlib import Path
from stat import S_IRWXG, S_IRWXO
from typing import Annotated, Any, Self
from zlib import crc32

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from zenostat.topics.device_addresses import MAX_INSTANCE
from zenostat.topics.errors import AccessDenied, InvalidConfig, did_you_mean
from zenostat.topics.keys import is_own, safe_name
from zenostat.topics.model_file import FileErrors, read_with_lines
from zenostat.topics.printable import replace_controls

EVERYONE = "*"
"""Stands for all clients in `--allow`, also for those without a name."""

EVERYTHING = "*"
"""Pattern of all points; a request on no single point needs it, and no other pattern permits it."""

_USER = 55
"""Characters of an MQTT user's name in that of its commands, before a checksum."""
_TOKEN = re.compile(r"[\x21-\x7e]{16,512}")
_NAME = r"^[A-Za-z0-9_][A-Za-z0-9_\-]{0,63}$"


def _network(value: Any) -> Any:
    if not isinstance(value, str):
        raise ValueError("expected an IP address such as 192.168.1.20, or a network such as 192.168.1.0/24")
    try:
        return ip_network(value)
    except ValueError as error:
        raise ValueError(f"{error}; expected an IP address, or a network such as 192.168.1.0/24") from None


Network = Annotated[IPv4Network | IPv6Network, BeforeValidator(_network, json_schema_input_type=str)]
Pattern = Annotated[str, Field(min_length=1, max_length=200)]
ClientName = Annotated[str, Field(pattern=_NAME)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class _Address(_Part):
    """A client by its address and a number of its protocol; those that are given must all be the client's."""

    address: Network | None = Field(None, description="IP address of the client, or the network that it is in.")

    @model_validator(mode="after")
    def _is_any(self) -> Self:
        if all(getattr(self, name) is None for name in type(self).model_fields):
            raise ValueError(f"expected {' or '.join(type(self).model_fields)}, or both")
        return self

    def matches_address(self, host: str) -> bool:
        """Return whether a host is the client's, as far as the file names its address."""
        if self.address is None:
            return True
        try:
            return ip_address(host.partition("%")[0]) in self.address
        except ValueError:  # behind a BACnet router, which has addresses of another kind
            return False


class ModbusClient(_Address):
    """A Modbus client: the unit id that it asks for, its address, or both."""

    unit: int | None = Field(None, ge=0, le=255, strict=True, description="Unit id in the client's requests.")


class BacnetClient(_Address):
    """A BACnet client: the instance of its device, its address, or both."""

    instance: int | None = Field(
        None, ge=0, le=MAX_INSTANCE, strict=True, description="Instance of the client's own device object."
    )


class ClientSpec(_Part):
    """A client: how each protocol knows it, and what it may write."""

    mqtt: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        None, description="User name at the broker, as in the client's topics."
    )
    boptest: str | None = Field(
        None, description="Bearer token of the client's requests, 16 to 512 ASCII characters; keep it secret."
    )
    bacnet: BacnetClient | None = Field(None, description="Device instance, address, or both.")
    modbus: ModbusClient | None = Field(None, description="Unit id, address, or both.")
    fmi: Network | None = Field(None, description="IP address of the tool that runs the FMU, or its network.")
    allow: tuple[Pattern, ...] = Field((), description="Actuators that it may write, with * and ?.")


class ClientsFile(_Part):
    """The clients of all gateways, by name."""

    clients: dict[ClientName, ClientSpec] = Field(min_length=1, description="Clients by name.")


@dataclass(frozen=True)
class Clients:
    """Names and permissions of a gateway's clients.

    Attributes:
        specs: clients by name.
        allowed: for each name, patterns of the actuators that it may write; for `*`, those of all clients.
        is_restricted: whether only what is allowed may be written; otherwise, everything may.
    """

    specs: Mapping[str, ClientSpec]
    allowed: Mapping[str, Sequence[str]]
    is_restricted: bool

    @property
    def is_read_only(self) -> bool:
        """Whether no client may write anything."""
        return self.is_restricted and not any(self.allowed.values())

    @property
    def description(self) -> str:
        """Names of those who may write, for the first line of a gateway."""
        if not self.is_restricted:
            return "each client may write"
        if self.is_read_only:
            return "read-only"
        return f"{', '.join(name for name, patterns in self.allowed.items() if patterns)} may write"

    # Names; empty for a client that is not in the file

    def of_mqtt(self, user: str) -> str:
        """Return the name of an MQTT user; without a file and `--allow`, it is the user's own.

        A name that cannot be a part of a source is changed, and gets a checksum, so that no two users have one source.
        """
        for name, spec in self.specs.items():
            if spec.mqtt == user:
                return name
        if self.is_restricted:
            return ""
        own = safe_name(user).replace(".", "_")[:_USER]
        return own if own == user else f"{own}_{crc32(user.encode()):08x}"

    def of_sender(self, sender: str) -> str:
        """Return the client under whose name, or a name below it, a sender is; empty if no client is."""
        return next((name for name in self.allowed if is_own(name, sender)), "")

    def of_boptest(self, token: str) -> str:
        """Return the name of the client that has a token."""
        digest = sha256(token.encode()).digest()  # comparing digests does not show how much of a token is right
        for name, spec in self.specs.items():
            if spec.boptest is not None and sha256(spec.boptest.encode()).digest() == digest:
                return name
        return ""

    def of_modbus(self, host: str, unit: int) -> str:
        """Return the name of a Modbus client by its address and the unit id of its request."""
        for name, spec in self.specs.items():
            client = spec.modbus
            if client is not None and client.unit in (None, unit) and client.matches_address(host):
                return name
        return ""

    def of_bacnet(self, host: str, instance: int | None) -> str:
        """Return the name of a BACnet client by its address and the instance of its device, None if unknown."""
        for name, spec in self.specs.items():
            client = spec.bacnet
            if client is not None and client.instance in (None, instance) and client.matches_address(host):
                return name
        return ""

    def of_fmi(self, host: str) -> str:
        """Return the name of the client that runs an FMU, by its address."""
        address = ip_address(host.partition("%")[0])
        return next((name for name, spec in self.specs.items() if spec.fmi is not None and address in spec.fmi), "")

    @property
    def bacnet_instances(self) -> frozenset[int]:
        """The device instances by which the file knows BACnet clients."""
        clients = (spec.bacnet for spec in self.specs.values())
        return frozenset(client.instance for client in clients if client is not None and client.instance is not None)

    # Permissions

    def denial(self, client: str, point: str) -> str:
        """Return why a client may not write a point; empty if it may.

        Args:
            client: its name; empty for one that is not in the file.
            point: the actuator, or the object that is written; `*` for a request that is no write of some.
        """
        if not self.is_restricted:
            return ""
        own = self._patterns(client)
        if EVERYTHING in own or (point != EVERYTHING and any(fnmatchcase(point, pattern) for pattern in own)):
            return ""
        name = client or "a client that neither --clients nor --allow names"
        what = "make this request, for which it must be allowed '*'" if point == EVERYTHING else f"write {point[:200]}"
        return replace_controls(f"{name} may not {what}; it may write {', '.join(own) or 'nothing'}")

    def check(self, client: str, points: Iterable[str]) -> None:
        """Raise `AccessDenied` unless a client may write all of some points."""
        for point in points:
            if reason := self.denial(client, point):
                raise AccessDenied(reason)

    def may_write(self, client: str) -> bool:
        """Return whether a client may write any point."""
        return not self.is_restricted or bool(self._patterns(client))

    def _patterns(self, client: str) -> list[str]:
        own = self.allowed.get(client, ()) if client else ()
        return [*own, *self.allowed.get(EVERYONE, ())]


UNRESTRICTED = Clients({}, {}, is_restricted=False)
"""Each client may write everything, without a name."""


def read_clients(
    file: Path | None, allow: Sequence[str], *, is_exposed: bool, name_themselves: bool = False
) -> Clients:
    """Return the clients of a gateway.

    Args:
        file: the file of clients; None for none.
        allow: `NAME=PATTERN` each, in addition to those in the file; the name `*` stands for all clients.
        is_exposed: whether other machines reach the gateway. Then nobody may write unless a file or `allow` says so.
        name_themselves: whether clients of the protocol send their name, so that `allow` may have names that no file
            has.

    Raises:
        InvalidConfig: the file cannot be read or is not valid, or others may read its tokens; an entry of `allow` is
            not valid, or its name is not in the file.
    """
    specs = {} if file is None else dict(_read_file(file).clients)
    allowed = {name: [*spec.allow] for name, spec in specs.items()}
    for text in allow:
        name, is_pair, pattern = text.partition("=")
        if not is_pair or not name or not pattern:
            raise InvalidConfig(f"--allow {text}: expected NAME=PATTERN, for example --allow panel=core_*_setpoint")
        if name != EVERYONE and name not in specs:
            if file is not None or not name_themselves:
                known = [*specs, EVERYONE]
                where = f"{file}" if file is not None else "a file of clients (--clients)"
                raise InvalidConfig(f"--allow {text}: {name!r} is not a client in {where}; {did_you_mean(name, known)}")
            if not re.fullmatch(_NAME, name):
                raise InvalidConfig(
                    f"--allow {text}: {name!r} is not a name: use up to 64 letters, digits, '_' and '-'"
                )
            specs[name] = ClientSpec(mqtt=name)
        allowed.setdefault(name, []).append(pattern)
    return Clients(specs, allowed, is_restricted=is_exposed or file is not None or bool(allow))


def _read_file(path: Path) -> ClientsFile:
    spec, _, errors = read_with_lines(path, ClientsFile)
    _check_tokens(spec, errors)
    _check_distinct(spec, errors)
    errors.raise_if_any()
    if any(client.boptest is not None for client in spec.clients.values()):
        mode = errors.path.stat().st_mode
        if mode & (S_IRWXG | S_IRWXO):
            raise InvalidConfig(f"{path} has tokens and others may read it (mode {mode & 0o777:o}): chmod 600 {path}")
    return spec


def _check_tokens(spec: ClientsFile, errors: FileErrors) -> None:
    """Add an error for each token that is not one; its text does not repeat the token."""
    for name, client in spec.clients.items():
        if client.boptest is not None and not _TOKEN.fullmatch(client.boptest):
            errors.add(
                ("clients", name, "boptest"),
                f"clients.{name}.boptest: expected a token of 16 to 512 ASCII characters without spaces, for example "
                "that of `openssl rand -hex 16`",
            )


def _check_distinct(spec: ClientsFile, errors: FileErrors) -> None:
    """Add an error for each client that a protocol cannot tell from an earlier one."""
    seen: dict[tuple[str, object], str] = {}
    for name, client in spec.clients.items():
        for protocol in ("mqtt", "boptest", "bacnet", "modbus", "fmi"):
            known = getattr(client, protocol)
            if known is None:
                continue
            first = seen.setdefault((protocol, known), name)
            if first != name:
                errors.add(
                    ("clients", name, protocol), f"clients.{name}.{protocol}: {first} has the same; each needs its own"
                )
