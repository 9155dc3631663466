"""The district of `zenostat demo district`: its file, its feeder and its profiles."""

from __future__ import annotations

import shutil
from pathlib import Path

FILES = ("district.yaml", "feeder.yaml", "profiles.csv")


def copy_files(folder: Path) -> Path:
    """Copy the files to a folder, to be read and changed there; return that of the district."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        shutil.copyfile(Path(__file__).with_name(name), folder / name)
    return folder / FILES[0]
