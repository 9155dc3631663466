"""Certificates in a folder of keys: what each states, whether it can be used, and that of a program on the bus."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from math import ceil
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import NameOID

from zenostat.bridge.transport.access_control import TRAINER, includes
from zenostat.bridge.transport.certificate_files import check_private, read_certificate, read_key
from zenostat.bridge.transport.name_list import CERTIFIED, NAMES, Names, read_names
from zenostat.topics.errors import ErrorCollector, InvalidConfig, UnknownName, did_you_mean
from zenostat.topics.keys import Role

AUTHORITY = "ca"
EXPIRES_SOON = timedelta(days=30)
"""Time before the end of a certificate's validity from which it is warned of."""
_MINUTE = "%Y-%m-%d %H:%M UTC"
_SKEW = timedelta(minutes=1)
_RENEW = "renew it with: zenostat keys add NAME --role ROLE --force"


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
        """Text that the certificate has expired; empty while it is valid. Clocks may differ by a minute.

        Zenoh reads the file again whenever it connects, so one that has been renewed has not expired.
        """
        soon, expires = datetime.now(UTC) + _SKEW, self.expires
        if expires <= soon:
            with suppress(InvalidConfig):
                expires = read_certificate(self.certificate).not_valid_after_utc
        return "" if expires > soon else f"{self.certificate} {expired_on(expires)}"

    def names(self) -> dict[str, tuple[Role, ...]]:
        """Return the names of the authority, with the roles of each; `InvalidConfig` if the list cannot be used."""
        return read_names(self.authority.parent, read_certificate(self.authority))


def identity(folder: Path, role: Role | Sequence[Role] | None, name: str | None = None) -> Identity:
    """Validate a certificate, and return its files.

    Args:
        folder: of the keys.
        role: that it must have, or several; None is any, except a node's.
        name: of the certificate; None is that of the role, of several roles `trainer`.

    Raises:
        InvalidConfig: neither role nor name, no such folder or file, an expired certificate, one of another authority
            or role, a key that does not match or that other users can read; the text lists all errors.
        UnknownName: there is no certificate of that name.
    """
    needed = (role,) if isinstance(role, Role) else tuple(role or ())
    if name is None and not needed:
        raise InvalidConfig(f"name a certificate or a role: {', '.join(CERTIFIED)}")
    if any(character in str(folder) for character in ";?"):
        raise InvalidConfig(f"Zenoh cannot read keys from {folder}: choose a path without ';' and '?'")
    name = name or (needed[0].value if len(needed) == 1 else TRAINER)
    authority = read_certificate(folder / f"{AUTHORITY}.pem")
    path, key = folder / f"{name}.pem", folder / f"{name}.key"
    if not path.exists():
        known = [certificate.name for certificate in show(folder) if not _missing(needed, certificate.roles)]
        options = "".join(f" --role {each}" for each in needed or (Role.CONTROLLER,))
        raise UnknownName(
            f"no certificate {name!r} in {folder}; {did_you_mean(name, known)}. "
            f"Create it with: zenostat keys add {name}{options}"
        )
    certificate = read_certificate(path)
    errors = ErrorCollector()
    described = describe(name, certificate, authority)
    if described.fault:
        errors.errors.append(InvalidConfig(f"{path}: {described.fault}"))
    if _missing(needed, described.roles):
        having = " and ".join(described.roles) or "authority"
        example = f", as {TRAINER}.pem has" if len(needed) > 1 else ""
        errors.errors.append(InvalidConfig(f"{path} is of the role {having}; {' and '.join(needed)} expected{example}"))
    if not needed and Role.NODE in described.roles:
        errors.errors.append(InvalidConfig(f"{path} is that of a node; another program connects with its own"))
    errors.collect(lambda: _check_key(key, certificate))
    errors.raise_if_any()
    return Identity(folder / f"{AUTHORITY}.pem", path, key, _holder(certificate), described.roles, described.expires)


def _missing(needed: Sequence[Role], roles: Sequence[Role]) -> list[Role]:
    """Return the needed roles that a certificate with these roles lacks."""
    return [role for role in needed if not any(includes(each, role) for each in roles)]


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


def _shown(path: Path, authority: x509.Certificate, listed: Names | None) -> Certificate:
    certificate, key = read_certificate(path), path.with_suffix(".key")
    described = describe(path.stem, certificate, authority)
    if described.fault:
        return described
    if key.exists():
        try:
            _check_key(key, certificate)
        except InvalidConfig as error:
            return replace(described, fault=str(error))
    if listed is not None and path.stem != AUTHORITY and (holder := _holder(certificate)) not in listed:
        return replace(
            described, fault=f"{holder!r} is not in {NAMES}, so no node accepts it; add it: zenostat keys add"
        )
    return described


def _holder(certificate: x509.Certificate) -> str:
    """Return the common name of a certificate."""
    return str(certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def _check_key(path: Path, certificate: x509.Certificate) -> None:
    if read_key(path).public_key() != certificate.public_key():
        raise InvalidConfig(f"{path} does not match the certificate next to it")
    check_private(path)


def describe(name: str, certificate: x509.Certificate, authority: x509.Certificate) -> Certificate:
    """Return what a certificate states, and why it cannot be used, if so, but for its files; `name`: of these."""
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


def expiry_warning(expires: datetime) -> str:
    """Return when a certificate expires or has expired, if that is within 30 days."""
    left = expires - datetime.now(UTC)
    if left > EXPIRES_SOON:
        return ""
    if left <= timedelta(0):
        return expired_on(expires)
    hours, days = int(left / timedelta(hours=1)), left.days
    duration = f"{days} days" if days > 1 else f"{hours} h" if hours else f"{ceil(left / timedelta(minutes=1))} min"
    return f"expires on {expires:{_MINUTE}}, in {duration}; {_RENEW}"


def expired_on(expires: datetime) -> str:
    """Return when a certificate has expired, and the remedy."""
    return f"expired on {expires:{_MINUTE}}; {_RENEW}"
