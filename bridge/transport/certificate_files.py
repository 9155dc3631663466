"""Files of certificates and private keys: PEM, the keys readable by their owner alone."""

from __future__ import annotations

import os
import stat
from codecs import BOM_UTF8
from collections.abc import Callable
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key

from zenostat.bridge.transport.name_list import NAMES, Names, sign_names
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.user_file import user_file


def write_certificate(folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
    """Write `NAME.pem` and `NAME.key` to a folder; `InvalidConfig` if it cannot be written to."""
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    for path, data, mode in (
        (folder / f"{name}.key", secret, 0o600),
        (folder / f"{name}.pem", certificate.public_bytes(Encoding.PEM), 0o644),
    ):
        in_folder(folder, lambda path=path, data=data, mode=mode: _write_file(path, data, mode))  # type: ignore[misc]


def write_names(folder: Path, names: Names, key: ec.EllipticCurvePrivateKey) -> None:
    """Write the list of names, signed by the authority; `InvalidConfig` if the folder cannot be written to."""

    def write() -> None:
        with atomic_file(folder / NAMES) as temporary:
            _write_file(temporary, sign_names(names, key), 0o644)
            temporary.chmod(0o644)  # whatever the umask: nodes may be another user's

    in_folder(folder, write)


def _write_file(path: Path, data: bytes, mode: int) -> None:
    path.unlink(missing_ok=True)  # never write into a file that others can read, nor through a link
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(data)


def in_folder(folder: Path, function: Callable[[], None]) -> None:
    """Call a function that writes to a folder; `InvalidConfig` if that fails."""
    try:
        function()
    except OSError as error:
        raise InvalidConfig(f"cannot write to {folder}: {error.strerror}") from None


def read_certificate(path: Path) -> x509.Certificate:
    """Read a certificate; `InvalidConfig` if there is none."""
    content = _read_pem(path, f"create a folder of keys with: zenostat keys init {path.parent}")
    try:
        return x509.load_pem_x509_certificate(content)
    except ValueError:
        raise InvalidConfig(f"{path} is not a certificate (PEM)") from None


def read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """Read a private key that `zenostat keys` created; `InvalidConfig` if there is none."""
    content = _read_pem(path, "it is on the machine where the keys were created")
    try:
        key = load_pem_private_key(content, None)
    except (ValueError, TypeError):
        raise InvalidConfig(f"{path} is not a private key without a password (PEM)") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise InvalidConfig(f"{path} was not created by zenostat keys")
    return key


def _read_pem(path: Path, remedy: str) -> bytes:
    """Read a PEM file; `InvalidConfig` if there is none, with the remedy, or if Zenoh could not read it."""
    with user_file(path, expected="a PEM file", remedy=remedy):
        content = path.read_bytes()
    if content.startswith(BOM_UTF8):
        raise InvalidConfig(f"{path} begins with a byte order mark, which PEM does not have; save it without")
    return content


def check_private(key: Path) -> None:
    """Raise `InvalidConfig` if other users can read a key's file."""
    if key.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InvalidConfig(f"{key} can be read by other users; restrict its permissions: chmod 600 {key}")
