"""Certificates of a secured bus.

A folder of keys contains an authority (`ca.pem`, `ca.key`), its list of names (`names.json`) and, for each program or
person, `NAME.pem` and `NAME.key`. A certificate's common name is that name, which Zenoh's access control uses; its
organizational units are the roles. Only node certificates are valid for TLS servers, so no other program can listen.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from zenostat.bridge.transport.access_control import TRAINER
from zenostat.bridge.transport.certificate_files import (
    check_private,
    in_folder,
    open_to_others,
    read_certificate,
    read_key,
    write_certificate,
    write_names,
)
from zenostat.bridge.transport.name_list import (
    CERTIFIED,
    NAMES,
    Names,
    check_new_name,
    check_roles,
    locked_names,
    read_names,
)
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.keys import Role

AUTHORITY = "ca"
DAYS = 365
MAX_DAYS = 3650
"""Validity of an authority, and so the longest validity of its certificates."""

_FIRST: Names = {**{role.value: (role,) for role in CERTIFIED}, TRAINER: (Role.CONTROLLER, Role.OPERATOR)}
"""The names for which `make` creates certificates."""

_LOCAL = ("localhost", "127.0.0.1", "::1")
EXPIRES_SOON = timedelta(days=30)
"""Time before the end of a certificate's validity from which it is warned of."""

_MINUTE = "%Y-%m-%d %H:%M UTC"
_SKEW = timedelta(minutes=1)
_RENEW = "renew it with: zenostat keys add --force"
_BACKDATED = timedelta(hours=1)  # the clocks of machines differ


@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate in a folder.

    Attributes:
        name: of its files.
        roles: none for the authority itself.
        expires: end of its validity, UTC.
        hosts: names and addresses of a node's machine.
        fault: why it cannot be used; empty if it can.
        warning: when it expires, if that is soon.
    """

    name: str
    roles: tuple[Role, ...]
    expires: datetime
    hosts: tuple[str, ...] = ()
    fault: str = ""
    warning: str = ""


@dataclass(frozen=True, slots=True)
class Identity:
    """Validated files that a program presents on the bus, and what its certificate states.

    Attributes:
        authority, certificate, key: the files.
        name: the certificate's common name.
        roles: its roles.
        expires: end of its validity, UTC.
    """

    authority: Path
    certificate: Path
    key: Path
    name: str
    roles: tuple[Role, ...]
    expires: datetime

    @property
    def warning(self) -> str:
        """Date on which the certificate expires, if that is soon."""
        warning = expiry_warning(self.expires)
        return f"{self.certificate} {warning}" if warning else ""

    @property
    def expired(self) -> str:
        """Text that the certificate has expired; empty while it is valid. Clocks may differ by a minute."""
        if self.expires > datetime.now(UTC) + _SKEW:
            return ""
        return f"{self.certificate} {expired_on(self.expires)}"

    def names(self) -> dict[str, tuple[Role, ...]]:
        """Return the names of the authority, with the roles of each; `InvalidConfig` if the list cannot be used."""
        return read_names(self.authority.parent, read_certificate(self.authority))


def make(folder: Path, *, hosts: Sequence[str] = (), days: int = DAYS, force: bool = False) -> list[Certificate]:
    """Create an authority, a certificate for each role, with the role as its name, and that of environments.

    Args:
        folder: the folder, which is created if it does not exist.
        hosts: names and addresses of the node's machine, besides those of the loopback.
        days: validity of the certificates; the authority is valid for ten years.
        force: overwrite existing files. Certificates of the previous authority become invalid.

    Raises:
        InvalidConfig: existing files, an invalid host, days out of range.
    """
    errors = ErrorCollector()
    names = errors.collect(lambda: _hosts(hosts))
    errors.collect(lambda: _check_days(days, MAX_DAYS))
    if not force:
        errors.collect(lambda: _refuse_existing(folder, [AUTHORITY, *_FIRST]))
    errors.raise_if_any()
    authority_key = ec.generate_private_key(ec.SECP256R1())
    authority = _authority(authority_key)
    created = [(AUTHORITY, authority, authority_key)]
    for name, roles in _FIRST.items():
        key = ec.generate_private_key(ec.SECP256R1())
        created.append((name, _issued(authority, authority_key, key, roles, name, names or (), days), key))
    in_folder(folder, lambda: folder.mkdir(mode=0o700, parents=True, exist_ok=True))
    for name, certificate, key in created:
        write_certificate(folder, name, certificate, key)
    write_names(folder, _FIRST, authority_key)
    return show(folder)


def add(
    folder: Path,
    roles: Role | Sequence[Role],
    name: str,
    *,
    hosts: Sequence[str] = (),
    days: int = DAYS,
    force: bool = False,
) -> Certificate:
    """Create another certificate of the folder's authority, and add its name to the list.

    One that replaces a node's keeps its hosts unless others are named.

    Raises:
        InvalidConfig: no authority, or one whose key other users can read, a name that is in use or is the beginning of
            another, hosts for a role that does not listen, days beyond the authority's validity.
    """
    authority = read_certificate(folder / f"{AUTHORITY}.pem")
    authority_key = read_key(folder / f"{AUTHORITY}.key")
    if force and not hosts:
        hosts = _former_hosts(folder / f"{name}.pem", authority)
    with locked_names(folder):
        return _add(folder, roles, name, authority, authority_key, hosts, days, force=force)


def _former_hosts(path: Path, authority: x509.Certificate) -> tuple[str, ...]:
    return _described(path.stem, read_certificate(path), authority).hosts if path.exists() else ()


def _add(
    folder: Path,
    roles: Role | Sequence[Role],
    name: str,
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    hosts: Sequence[str],
    days: int,
    *,
    force: bool,
) -> Certificate:
    max_days = (authority.not_valid_after_utc - datetime.now(UTC)).days
    errors = ErrorCollector()
    errors.collect(lambda: check_private(folder / f"{AUTHORITY}.key"))
    listed = errors.collect(lambda: read_names(folder, authority))
    errors.collect(lambda: _check_name(name, listed or {}))
    errors.collect(lambda: _check_days(days, max_days))
    chosen = errors.collect(lambda: check_roles((roles,) if isinstance(roles, Role) else roles)) or ()
    names = errors.collect(lambda: _hosts(hosts)) if Role.NODE in chosen else ()
    if hosts and chosen and Role.NODE not in chosen:
        errors.errors.append(
            InvalidConfig(f"a {' and '.join(chosen)} does not listen; hosts are for a node's certificate")
        )
    if not force:
        errors.collect(lambda: _refuse_existing(folder, [name]))
    errors.raise_if_any()
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = _issued(authority, authority_key, key, chosen, name, names or (), days)
    write_certificate(folder, name, certificate, key)
    write_names(folder, {**(listed or {}), name: chosen}, authority_key)
    return _described(name, certificate, authority)


def names_of(folder: Path) -> dict[str, tuple[Role, ...]]:
    """Return the roles of each name in a folder's list; `InvalidConfig` if it cannot be used."""
    return read_names(folder, read_certificate(folder / f"{AUTHORITY}.pem"))


def show(folder: Path) -> list[Certificate]:
    """Return the certificates of a folder: authority first, then by role and name."""
    authority = read_certificate(folder / f"{AUTHORITY}.pem")
    paths = [path for path in sorted(folder.glob("*.pem")) if _is_certificate(path)]
    listed: Names | None = None  # where there is no list that can be used, as in a program's own folder
    with suppress(InvalidConfig):
        listed = read_names(folder, authority)
    certificates = [_shown(path, authority, listed) for path in paths]
    return sorted(certificates, key=lambda c: (CERTIFIED.index(c.roles[0]) if c.roles else -1, c.name))


def _is_certificate(path: Path) -> bool:
    """Return whether a file is a certificate, or should be one since it has a key; others may be in the folder, too."""
    try:
        read_certificate(path)
    except InvalidConfig:
        return path.with_suffix(".key").exists()
    return True


def expiry_warning(expires: datetime) -> str:
    """Return when a certificate expires or has expired, if that is within 30 days."""
    left = expires - datetime.now(UTC)
    if left > EXPIRES_SOON:
        return ""
    if left <= timedelta(0):
        return expired_on(expires)
    duration = f"{left.days} days" if left.days > 1 else f"{int(left.total_seconds() / 3600)} h"
    return f"expires on {expires:{_MINUTE}}, in {duration}; {_RENEW}"


def expired_on(expires: datetime) -> str:
    """Return when a certificate has expired, and the remedy."""
    return f"expired on {expires:{_MINUTE}}; {_RENEW}"


def _shown(path: Path, authority: x509.Certificate, listed: Names | None) -> Certificate:
    certificate, key = read_certificate(path), path.with_suffix(".key")
    described = _described(path.stem, certificate, authority)
    if described.fault:
        return described
    if fault := open_to_others(key):
        return replace(described, fault=f"{key.name} {fault}")
    if listed is not None and path.stem != AUTHORITY and (holder := _holder(certificate)) not in listed:
        return replace(
            described, fault=f"{holder!r} is not in {NAMES}, so no node accepts it; add it: zenostat keys add"
        )
    return described


def _holder(certificate: x509.Certificate) -> str:
    """Return the common name of a certificate."""
    return str(certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def identity(folder: Path, role: Role | None, name: str | None = None) -> Identity:
    """Validate a certificate, and return its files.

    Args:
        folder: of the keys.
        role: that it must have; None is any, except a node's.
        name: of the certificate; None is that of the role.

    Raises:
        InvalidConfig: neither role nor name, no such folder or file, an expired certificate, one of another authority
            or role, a key that does not match or that other users can read; the text lists all errors.
        UnknownName: there is no certificate of that name.
    """
    if name is None and role is None:
        raise InvalidConfig(f"name a certificate or a role: {', '.join(CERTIFIED)}")
    name = name or str(role)
    authority = read_certificate(folder / f"{AUTHORITY}.pem")
    path, key = folder / f"{name}.pem", folder / f"{name}.key"
    if not path.exists():
        known = [certificate.name for certificate in show(folder) if role in (None, *certificate.roles)]
        raise UnknownName(
            f"no certificate {name!r} in {folder}; {did_you_mean(name, known)}. "
            f"Create it with: zenostat keys add {name} --role {role or Role.CONTROLLER}"
        )
    certificate = read_certificate(path)
    errors = ErrorCollector()
    described = _described(name, certificate, authority)
    if described.fault:
        errors.errors.append(InvalidConfig(f"{path}: {described.fault}"))
    if role not in (None, *described.roles):
        having = " and ".join(described.roles) or "authority"
        errors.errors.append(InvalidConfig(f"{path} is of the role {having}; {role} expected"))
    if role is None and Role.NODE in described.roles:
        errors.errors.append(InvalidConfig(f"{path} is that of a node; another program connects with its own"))
    errors.collect(lambda: _check_key(key, certificate))
    errors.raise_if_any()
    return Identity(folder / f"{AUTHORITY}.pem", path, key, _holder(certificate), described.roles, described.expires)


# Creation


def _authority(key: ec.EllipticCurvePrivateKey) -> x509.Certificate:
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "zenostat-authority")])
    usage = _usage(signs_certificates=True)
    return (
        _builder(name, name, key.public_key(), MAX_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, hashes.SHA256())
    )


def _issued(
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    key: ec.EllipticCurvePrivateKey,
    roles: Sequence[Role],
    name: str,
    hosts: Sequence[x509.GeneralName],
    days: int,
) -> x509.Certificate:
    subject = x509.Name(
        [
            x509.NameAttribute(NameOID.COMMON_NAME, name),
            *(x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role.value) for role in roles),
        ]
    )
    listens = Role.NODE in roles
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH] + [ExtendedKeyUsageOID.SERVER_AUTH] * listens
    builder = (
        _builder(subject, authority.subject, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False)
    )
    if listens:
        builder = builder.add_extension(x509.SubjectAlternativeName(hosts), critical=False)
    return builder.sign(authority_key, hashes.SHA256())


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BACKDATED)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _hosts(hosts: Sequence[str]) -> tuple[x509.GeneralName, ...]:
    errors = ErrorCollector()
    unique = dict.fromkeys((*_LOCAL, *hosts))
    names = [errors.collect(lambda host=host: _host(host)) for host in unique]  # type: ignore[misc]
    errors.raise_if_any()
    return tuple(name for name in names if name is not None)


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    labels = host.split(".")
    if not host.isascii() or not all(_is_label(label) for label in labels) or labels[-1].isdigit():
        raise InvalidConfig(f"{host!r} is not a host; write a name (lab.example.org) or an address (192.168.1.20)")
    return x509.DNSName(host)


def _is_label(text: str) -> bool:
    return 0 < len(text) < 64 and text.replace("-", "a").isalnum() and not text.startswith("-")


def _check_days(days: int, max_days: int) -> None:
    if not 1 <= days <= max_days:
        raise InvalidConfig(f"{days} days of validity; 1 to {max_days} expected, the validity of the authority")


def _check_name(name: str, listed: Names) -> None:
    check_new_name(name, listed)
    if name == AUTHORITY:
        raise InvalidConfig(f"{name!r} is the name of the authority; choose another name")


# Files


def _refuse_existing(folder: Path, names: Sequence[str]) -> None:
    files = [f"{name}.{kind}" for name in names for kind in ("pem", "key")]
    existing = [file for file in files if (folder / file).exists()]
    if existing:
        raise InvalidConfig(
            f"{folder} already has {', '.join(existing)}; choose another folder or name, or use --force"
        )


# Validation


def _check_key(path: Path, certificate: x509.Certificate) -> None:
    if read_key(path).public_key() != certificate.public_key():
        raise InvalidConfig(f"{path} does not match the certificate next to it")
    check_private(path)


def _described(name: str, certificate: x509.Certificate, authority: x509.Certificate) -> Certificate:
    units = {str(unit.value) for unit in certificate.subject.get_attributes_for_oid(NameOID.ORGANIZATIONAL_UNIT_NAME)}
    roles = tuple(role for role in CERTIFIED if role.value in units)
    try:
        alternative = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = tuple(str(name.value) for name in alternative)
    except x509.ExtensionNotFound:
        hosts = ()
    return Certificate(
        name,
        roles,
        certificate.not_valid_after_utc,
        hosts,
        _fault(certificate, authority),
        expiry_warning(certificate.not_valid_after_utc),
    )


def _fault(certificate: x509.Certificate, authority: x509.Certificate) -> str:
    now = datetime.now(UTC)
    if certificate.not_valid_after_utc < now:
        return expired_on(certificate.not_valid_after_utc)
    if certificate.not_valid_before_utc > now:
        return f"not valid before {certificate.not_valid_before_utc:{_MINUTE}}; is this machine's clock right?"
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return "of another authority than ca.pem next to it; use a folder whose files were created together"
    return ""
