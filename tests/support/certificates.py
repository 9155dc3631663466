"""Certificates that are not as they should be."""

from datetime import timedelta
from pathlib import Path

import pytest

from zenostat.bridge.transport import certificates
from zenostat.topics.keys import Role


def expire(folder: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes a controller's certificate whose last day was yesterday."""
    with monkeypatch.context() as patch:
        patch.setattr(certificates, "_BACKDATED", timedelta(days=3))
        patch.setattr(certificates, "_check_days", lambda *_: None)
        certificates.add(folder, Role.CONTROLLER, name, days=-1, force=True)


def house_keys(folder: Path) -> Path:
    """The keys of a house: one of each role, a second controller, and the trainer, who also resets."""
    certificates.make(folder)
    certificates.add(folder, Role.CONTROLLER, "second")
    return folder
