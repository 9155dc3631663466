"""Creation of the certificates of a secured bus.

A folder of keys contains an authority (`ca.pem`, `ca.key`), its list of names (`names.json`) and, for each program or
person, `NAME.pem` and `NAME.key`. A certificate's common name is that name, which Zenoh's access control uses; its
organizational units are the roles. Only node certificates are valid for TLS servers, so no other program can listen.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from zenostat.bridge.transport.access_control import RESETTING, TRAINER
from zenostat.bridge.transport.certificate_files import (
    check_private,
    in_folder,
    read_certificate,
    read_key,
    write_certificate,
    write_names,
)
from zenostat.bridge.transport.identity import AUTHORITY, Certificate, describe, show
from zenostat.bridge.transport.name_list import (
    CERTIFIED,
    Names,
    check_new_name,
    check_roles,
    locked_names,
    read_names,
)
from zenostat.topics.errors import ErrorCollector, InvalidConfig
from zenostat.topics.keys import Role

DAYS = 365
MAX_DAYS = 3650
"""Validity of an authority, and so the longest validity of its certificates."""

_FIRST: Names = {**{role.value: (role,) for role in CERTIFIED}, TRAINER: RESETTING}
"""The names for which `make` creates certificates."""

_LOCAL = ("localhost", "127.0.0.1", "::1")

_BACKDATED = timedelta(hours=1)  # the clocks of machines differ


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
    return describe(path.stem, read_certificate(path), authority).hosts if path.exists() else ()


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
    return describe(name, certificate, authority)


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
