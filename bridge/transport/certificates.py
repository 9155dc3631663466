"""Certificates: who may speak on a closed bus.

A folder of keys holds an authority (`ca.pem`, `ca.key`) and, for each program, `NAME.pem` and `NAME.key`. The role
stands in a certificate as its common name, `zenostat-controller`, where Zenoh's access control finds it; the
program's own name stands beside it as the organisational unit. Only a node's certificate is one of a TLS server, so
nobody else's can be listened with.
"""

from __future__ import annotations

import ipaddress
import os
import stat
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from bridge.transport.access_control import ROLES, common_name
from topics.errors import ErrorCollector, InvalidConfig, UnknownName, did_you_mean
from topics.keys import Role, check_name

AUTHORITY = "ca"
DAYS = 365
MAX_DAYS = 3650
"""How long an authority is good, and so the most for a certificate of a new one."""

_LOCAL = ("localhost", "127.0.0.1", "::1")
_BACKDATED = timedelta(hours=1)  # clocks of two machines differ


@dataclass(frozen=True, slots=True)
class Certificate:
    """One certificate of a folder.

    Attributes:
        name: of its files.
        role: None is the authority itself.
        expires: the end of its validity, UTC.
        hosts: under which names and addresses a node may be reached.
        fault: why it cannot be used; empty if it can.
    """

    name: str
    role: Role | None
    expires: datetime
    hosts: tuple[str, ...] = ()
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Identity:
    """The files that a program shows on the bus, checked."""

    authority: Path
    certificate: Path
    key: Path


def make(folder: Path, *, hosts: Sequence[str] = (), days: int = DAYS, force: bool = False) -> list[Certificate]:
    """Makes an authority and a certificate for each role.

    Args:
        folder: made if it is not there.
        hosts: names and addresses of the node's machine, besides those of the loopback.
        days: validity of the certificates; the authority's is ten years.
        force: overwrite. Certificates of the former authority are worthless then.

    Raises:
        InvalidConfig: files that are there already, a host that is none, days out of range.
    """
    faults = ErrorCollector()
    names = faults.collect(lambda: _hosts(hosts))
    faults.collect(lambda: _days(days, MAX_DAYS))
    if not force:
        faults.collect(lambda: _refuse_existing(folder, [AUTHORITY, *ROLES]))
    faults.raise_if_any()
    key = ec.generate_private_key(ec.SECP256R1())
    authority = _authority(key)
    made = [(AUTHORITY, authority, key)]
    for role in ROLES:
        own = ec.generate_private_key(ec.SECP256R1())
        made.append((role, _issued(authority, key, own, role, role, names or (), days), own))
    _in_folder(folder, lambda: folder.mkdir(mode=0o700, parents=True, exist_ok=True))
    for name, certificate, own in made:
        _write(folder, name, certificate, own)
    return show(folder)


def add(
    folder: Path, role: Role, name: str, *, hosts: Sequence[str] = (), days: int = DAYS, force: bool = False
) -> Certificate:
    """Makes another certificate of the folder's authority.

    Raises:
        InvalidConfig: no authority there, or one whose key others may read, a name that is taken, hosts for a role that
            does not listen, days that outlast the authority.
    """
    authority = _read(folder / f"{AUTHORITY}.pem")
    key = _read_key(folder / f"{AUTHORITY}.key")
    left = (authority.not_valid_after_utc - datetime.now(UTC)).days
    faults = ErrorCollector()
    faults.collect(lambda: _check_private(folder / f"{AUTHORITY}.key"))
    faults.collect(lambda: _check_name(name))
    names = faults.collect(lambda: _hosts(hosts)) if role is Role.NODE else ()
    faults.collect(lambda: _days(days, left))
    if role not in ROLES:
        faults.errors.append(InvalidConfig(f"there are no certificates for {role!r}; name one of {', '.join(ROLES)}"))
    elif hosts and role is not Role.NODE:
        faults.errors.append(InvalidConfig(f"a {role} does not listen; hosts are for a node's certificate"))
    if not force:
        faults.collect(lambda: _refuse_existing(folder, [name]))
    faults.raise_if_any()
    own = ec.generate_private_key(ec.SECP256R1())
    made = _issued(authority, key, own, role, name, names or (), days)
    _write(folder, name, made, own)
    return _described(name, made, authority)


def show(folder: Path) -> list[Certificate]:
    """The certificates of a folder: the authority, then by role and name; one whose key others may read has a fault."""
    authority = _read(folder / f"{AUTHORITY}.pem")
    found = [_shown(path, authority) for path in sorted(folder.glob("*.pem"))]
    return sorted(found, key=lambda one: (-1 if one.role is None else ROLES.index(one.role), one.name))


def _shown(path: Path, authority: x509.Certificate) -> Certificate:
    described, key = _described(path.stem, _read(path), authority), path.with_suffix(".key")
    fault = _open_to_others(key)
    return described if described.fault or not fault else replace(described, fault=f"{key.name} {fault}")


def identity(folder: Path, role: Role, name: str | None = None) -> Identity:
    """The files of the role's certificate, or of `name`'s, checked.

    Raises:
        InvalidConfig: no such folder or file, an expired certificate, one of another authority or role, a key that is
            not its own or that others may read; all faults at once.
        UnknownName: no certificate of that name.
    """
    name = name or role.value
    authority = _read(folder / f"{AUTHORITY}.pem")
    path, key = folder / f"{name}.pem", folder / f"{name}.key"
    if not path.exists():
        known = [one.name for one in show(folder) if one.role is role]
        raise UnknownName(
            f"no certificate {name!r} in {folder}; {did_you_mean(name, known)}. "
            f"Make it with: zenostat keys add {role} {name}"
        )
    certificate = _read(path)
    faults = ErrorCollector()
    described = _described(name, certificate, authority)
    if described.fault:
        faults.errors.append(InvalidConfig(f"{path}: {described.fault}"))
    if described.role is not role:
        faults.errors.append(InvalidConfig(f"{path} is of the role {described.role or 'authority'}; {role} expected"))
    faults.collect(lambda: _check_key(key, certificate))
    faults.raise_if_any()
    return Identity(folder / f"{AUTHORITY}.pem", path, key)


# Making


def _authority(key: ec.EllipticCurvePrivateKey) -> x509.Certificate:
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "zenostat-authority")])
    usage = _usage(signs_certificates=True)
    return (
        _begun(name, name, key.public_key(), MAX_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, hashes.SHA256())
    )


def _issued(
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    key: ec.EllipticCurvePrivateKey,
    role: Role,
    name: str,
    hosts: Sequence[x509.GeneralName],
    days: int,
) -> x509.Certificate:
    subject = x509.Name(
        [
            x509.NameAttribute(NameOID.COMMON_NAME, common_name(role)),
            x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, name[:64]),  # the most that X.509 allows
        ]
    )
    listens = role is Role.NODE
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH] + [ExtendedKeyUsageOID.SERVER_AUTH] * listens
    builder = (
        _begun(subject, authority.subject, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()),
            critical=False,
        )
    )
    if listens:
        builder = builder.add_extension(x509.SubjectAlternativeName(hosts), critical=False)
    return builder.sign(authority_key, hashes.SHA256())


def _begun(subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int) -> x509.CertificateBuilder:
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
    faults = ErrorCollector()
    named = dict.fromkeys((*_LOCAL, *hosts))
    found = [faults.collect(lambda host=host: _host(host)) for host in named]  # type: ignore[misc]
    faults.raise_if_any()
    return tuple(one for one in found if one is not None)


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    labels = host.split(".")
    if not host.isascii() or not all(_is_label(label) for label in labels) or labels[-1].isdigit():
        raise InvalidConfig(f"{host!r} is no host; write a name (lab.example.org) or an address (192.168.1.20)")
    return x509.DNSName(host)


def _is_label(text: str) -> bool:
    return 0 < len(text) < 64 and text.replace("-", "a").isalnum() and not text.startswith("-")


def _days(days: int, most: int) -> None:
    if not 1 <= days <= most:
        raise InvalidConfig(f"{days} days of validity; 1 to {most} expected, since the authority is good for so long")


def _check_name(name: str) -> None:
    check_name(name, "the certificate's name")
    if name == AUTHORITY:
        raise InvalidConfig(f"{name!r} is the authority; name the certificate else")


# Files


def _refuse_existing(folder: Path, names: Sequence[str]) -> None:
    there = [f"{name}.{kind}" for name in names for kind in ("pem", "key") if (folder / f"{name}.{kind}").exists()]
    if there:
        raise InvalidConfig(f"{folder} has {', '.join(there)} already; name another folder or name, or use --force")


def _write(folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    for path, data, mode in (
        (folder / f"{name}.key", secret, 0o600),
        (folder / f"{name}.pem", certificate.public_bytes(Encoding.PEM), 0o644),
    ):
        _in_folder(folder, lambda path=path, data=data, mode=mode: _write_file(path, data, mode))  # type: ignore[misc]


def _write_file(path: Path, data: bytes, mode: int) -> None:
    path.unlink(missing_ok=True)  # never into a file that others may read, nor through a link
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(data)


def _in_folder(folder: Path, do: Callable[[], None]) -> None:
    try:
        do()
    except OSError as error:
        raise InvalidConfig(f"cannot write to {folder}: {error.strerror}") from None


def _read(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError:
        raise InvalidConfig(
            f"there is no {path}; make a folder of keys with: zenostat keys init {path.parent}"
        ) from None
    except ValueError:
        raise InvalidConfig(f"{path} is no certificate (PEM)") from None


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    try:
        key = load_pem_private_key(path.read_bytes(), None)
    except FileNotFoundError:
        raise InvalidConfig(f"there is no {path}; it is on the machine where the keys were made") from None
    except OSError as error:
        raise InvalidConfig(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, TypeError):
        raise InvalidConfig(f"{path} is no private key without a password (PEM)") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise InvalidConfig(f"{path} is no key that zenostat keys has made")
    return key


# Checking


def _check_key(path: Path, certificate: x509.Certificate) -> None:
    if _read_key(path).public_key() != certificate.public_key():
        raise InvalidConfig(f"{path} is not the key of the certificate beside it")
    _check_private(path)


def _check_private(key: Path) -> None:
    if fault := _open_to_others(key):
        raise InvalidConfig(f"{key} {fault}")


def _open_to_others(key: Path) -> str:
    """What is wrong with the mode of a key's file; empty if nothing is, or there is none."""
    if key.exists() and key.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        return f"can be read by others; make it yours alone: chmod 600 {key}"
    return ""


def _described(name: str, certificate: x509.Certificate, authority: x509.Certificate) -> Certificate:
    said = [str(one.value) for one in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    role = next((role for role in ROLES if said == [common_name(role)]), None)
    try:
        alternative = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = tuple(str(one.value) for one in alternative)
    except x509.ExtensionNotFound:
        hosts = ()
    return Certificate(name, role, certificate.not_valid_after_utc, hosts, _fault(certificate, authority))


def _fault(certificate: x509.Certificate, authority: x509.Certificate) -> str:
    now = datetime.now(UTC)
    if certificate.not_valid_after_utc < now:
        return f"expired on {certificate.not_valid_after_utc:%Y-%m-%d}; make it anew with: zenostat keys add --force"
    if certificate.not_valid_before_utc > now:
        return f"not valid before {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC; is this machine's clock right?"
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return "of another authority than ca.pem beside it; use a folder whose files were made together"
    return ""
