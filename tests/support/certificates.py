"""Certificates that are not as they should be."""

from datetime import timedelta
from pathlib import Path

import pytest

from zenostat.bridge.transport import certificates
from zenostat.topics.keys import Role


def expire(
    folder: Path, name: str, monkeypatch: pytest.MonkeyPatch, role: Role = Role.CONTROLLER, days: float = -1
) -> None:
    """Makes a certificate, by default a controller's, whose last day was yesterday, or that is valid for some days."""
    with monkeypatch.context() as patch:
        patch.setattr(certificates, "_BACKDATED", timedelta(days=3))
        patch.setattr(certificates, "_check_days", lambda *_: None)
        certificates.add(folder, role, name, days=days, force=True)  # type: ignore[arg-type]


def house_keys(folder: Path) -> Path:
    """The keys of a house: one of each role, a second controller, and the trainer, who also resets."""
    certificates.make(folder)
    certificates.add(folder, Role.CONTROLLER, "second")
    return folder
