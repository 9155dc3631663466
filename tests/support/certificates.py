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
