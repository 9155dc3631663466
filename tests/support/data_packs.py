"""The data packs in tests: the real one, fetched with pip where it is not there yet, and wheels made by hand."""

import hashlib
import zipfile
from pathlib import Path

from zenostat.models import data_packs
from zenostat.models.data_packs import Pack


def sinergym() -> Path:
    """The folder of the real pack in the present store (`.../packs/sinergym-VERSION`); the files are in `sinergym/`.

    The usual store is used by all test runs, so that it is fetched once; workers that ask at once wait for one.
    """
    return data_packs.add("sinergym")


def wheel(folder: Path, files: dict[str, str], *, name: str = "zenostat_fake_pack", version: str = "1.0") -> Path:
    """A wheel for pip with these files, in `folder`."""
    info = f"{name}-{version}.dist-info"
    whole = files | {
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/RECORD": "",
    }
    path = folder / f"{name}-{version}-py3-none-any.whl"
    folder.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for inside, text in whole.items():
            archive.writestr(inside, text)
    return path


def pack_of(path: Path, *, sha256: str = "", version: str = "1.0") -> Pack:
    """The pack `fake` of such a wheel, which lists all of its files."""
    with zipfile.ZipFile(path) as archive:
        files = [Path(name) for name in archive.namelist()]
    return Pack(
        buildings=tuple(file.stem for file in files if file.suffix == ".epJSON"),
        weathers=tuple(file.stem for file in files if file.suffix == ".epw"),
        name="fake",
        requirement=f"zenostat-fake-pack=={version}",
        sha256=sha256 or hashlib.sha256(path.read_bytes()).hexdigest(),
        licence="MIT",
        about="two files",
        python_version="3.12",
        root="fake",
    )
