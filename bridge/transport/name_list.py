"""The list of names of an authority, with the roles of each: `names.json`, signed with the authority's key.

Zenoh's access rules match the common name of a certificate, which is the name of its holder. So a node that listens, or
a router, needs to know which names there are, and the roles of each. Whoever has only a certificate cannot change the
list.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec

from zenostat.topics.errors import InvalidConfig
from zenostat.topics.file_lock import locked
from zenostat.topics.keys import Role, check_name, is_own
from zenostat.topics.user_file import user_file

NAMES = "names.json"
"""Name of the file in a folder of keys."""

MAX_NAME = 64
"""Largest number of characters of a certificate's common name."""

CERTIFIED = (Role.NODE, Role.CONTROLLER, Role.OPERATOR, Role.MONITOR, Role.GATEWAY)
"""The roles of certificates."""

Names = Mapping[str, tuple[Role, ...]]
"""The roles of each name."""


LOCK_S = 30.0
"""Longest time that a command waits for another program that changes names."""


@contextmanager
def locked_names(folder: Path, *, wait_s: float = LOCK_S) -> Iterator[None]:
    """Let one program at a time change the files with names in a folder of keys.

    Raises:
        InvalidConfig: another one still does after this time, or the folder cannot be written.
    """
    refusal = f"another program is changing the names in {folder}; try again"
    with locked(folder / ".names.lock", refusal, wait_s=wait_s):
        yield


def check_roles(roles: Sequence[Role]) -> tuple[Role, ...]:
    """Return the roles of a name, without repetitions.

    Raises:
        InvalidConfig: none, one that no certificate has, or a node's with others.
    """
    unique = tuple(dict.fromkeys(roles))
    if not unique or any(role not in CERTIFIED for role in unique):
        unknown = ", ".join(repr(str(role)) for role in unique if role not in CERTIFIED) or "no role"
        raise InvalidConfig(f"there are no certificates for {unknown}; name one of {', '.join(CERTIFIED)}")
    if Role.NODE in unique and len(unique) > 1:
        raise InvalidConfig("a node has no further role: it is trusted with all messages")
    return unique


def check_new_name(name: str, names: Names) -> str:
    """Return a name that can be added to a list.

    Raises:
        InvalidConfig: it is not valid in a topic, is too long, or its holder and that of another name could send under
            the same name.
    """
    check_name(name, "the certificate's name")
    if len(name) > MAX_NAME:
        raise InvalidConfig(f"the certificate's name has {len(name)} characters; at most {MAX_NAME} expected")
    for other in names:
        if other != name and (is_own(other, name) or is_own(name, other)):
            raise InvalidConfig(
                f"{name!r} and {other!r}: a holder of the shorter name may send under the longer one; choose a name "
                "that is not the beginning of the other"
            )
    return name


def holder(names: Names, sender: str) -> str:
    """Return the name of the certificate under which a sender's name is; empty if there is none."""
    return next((name for name in names if is_own(name, sender)), "")


def sign_names(names: Names, key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return the content of the file."""
    roles = {name: list(names[name]) for name in sorted(names)}
    signature = key.sign(_signed(roles), ec.ECDSA(hashes.SHA256()))
    return json.dumps({"names": roles, "signature": base64.b64encode(signature).decode()}, indent=1).encode()


def read_names(folder: Path, authority: x509.Certificate) -> dict[str, tuple[Role, ...]]:
    """Return the names of an authority.

    Raises:
        InvalidConfig: there is no list, it cannot be read or is damaged, or its authority has not signed it.
    """
    path = folder / NAMES
    remedy = "copy this list of names and roles from the folder where the keys were created"
    with user_file(path, expected="a list of names", remedy=remedy):
        text = path.read_bytes()
    try:
        content = json.loads(text)
        roles, signature = content["names"], base64.b64decode(content["signature"], validate=True)
        names = {check_name(name, "name"): check_roles([Role(role) for role in roles[name]]) for name in roles}
    except (ValueError, TypeError, KeyError, AttributeError, binascii.Error, InvalidConfig) as error:
        raise InvalidConfig(f"{path} is not a list of names: {error}") from None
    public_key = authority.public_key()
    try:
        assert isinstance(public_key, ec.EllipticCurvePublicKey)
        public_key.verify(signature, _signed(roles), ec.ECDSA(hashes.SHA256()))
    except (AssertionError, InvalidSignature):
        raise InvalidConfig(
            f"{path} is not signed by the authority next to it; use a folder whose files were created together"
        ) from None
    return names


def _signed(roles: Mapping[str, Sequence[str]]) -> bytes:
    return b"zenostat names\n" + json.dumps(roles, sort_keys=True, separators=(",", ":")).encode()
