"""The content of an SSP file: its XML documents, checked against the standard's schemas, and its FMUs."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from zenostat.plants.fmi.model import MAX_BYTES
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import import_extra
from zenostat.topics.user_file import check_user_file

NAMESPACES = {
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
}
"""Namespaces of the standard's documents."""

STRUCTURE = "SystemStructure.ssd"
_SCHEMAS = {
    "ssd": "SystemStructureDescription.xsd",
    "ssm": "SystemStructureParameterMapping.xsd",
    "ssv": "SystemStructureParameterValues.xsd",
}
_LARGEST_DOCUMENT = 1 << 26
_LONGEST_NAME = 100
"""Characters of the name of an unpacked FMU, before a number."""


class Archive:
    """An SSP file that is open for reading.

    Args:
        path: the file.
        content: it as a ZIP archive.
    """

    def __init__(self, path: Path, content: zipfile.ZipFile) -> None:
        self.path, self._content = path, content
        self._names = {str(PurePosixPath(name)) for name in content.namelist()}
        self._copies: dict[Path, str] = {}

    def error(self, text: str, element: Any = None, document: str = STRUCTURE) -> InvalidConfig:
        """Return an error about an element of a document, with its line."""
        line = "" if element is None else f" line {element.sourceline}:"
        return InvalidConfig(f"{self.path}: {document}:{line} {text}")

    def document(self, name: str, kind: str) -> Any:
        """Return the root element of a document, which has the form that its schema requires.

        Args:
            name: its URI in the archive.
            kind: `ssd`, `ssm` or `ssv`.

        Raises:
            InvalidConfig: there is no such document, or it does not have this form.
        """
        name = self._find(name)
        if self._content.getinfo(name).file_size > _LARGEST_DOCUMENT:
            raise self.error(f"more than {_LARGEST_DOCUMENT >> 20} MB of XML", document=name)
        etree = import_extra("lxml.etree", "fmi", "an SSP file")
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
        try:
            root = etree.fromstring(self._read(name), parser)
        except etree.XMLSyntaxError as error:
            raise self.error(f"not XML: {error}", document=name) from None
        self.check(root, kind, name)
        return root

    def check(self, root: Any, kind: str, document: str = STRUCTURE) -> None:
        """Check an element against the schema of its kind of document.

        Raises:
            InvalidConfig: it does not have the form that the schema requires; names the first error and its line.
        """
        etree = import_extra("lxml.etree", "fmi", "an SSP file")
        expected = f"{{{NAMESPACES[kind]}}}"
        if not root.tag.startswith(expected):
            text = f"{etree.QName(root).localname} is in the namespace {etree.QName(root).namespace!r}; SSP 1.0 has "
            raise self.error(f"{text}{NAMESPACES[kind]!r}", root, document)
        folder = Path(import_extra("fmpy.ssp.ssd", "fmi", "an SSP file").__file__).parent / "schema"
        schema = etree.XMLSchema(file=str(folder / _SCHEMAS[kind]))
        if not schema.validate(root):
            first = schema.error_log[0]
            raise InvalidConfig(f"{self.path}: {document}: line {first.line}: {first.message}")

    def unpack(self, name: str, folder: Path) -> Path:
        """Copy an entry of the archive into a folder, where its folders become a part of its name; return the copy.

        Another entry whose copy would have the same name has a number before it.

        Raises:
            InvalidConfig: the archive does not have it.
        """
        entry = self._find(name)
        base = "_".join(part for part in PurePosixPath(entry).parts if part not in ("resources", "..", "/"))
        base = base[-_LONGEST_NAME:]  # with its suffix
        target, number = folder / base, 2
        while self._copies.setdefault(target, entry) != entry:
            target, number = folder / f"{number}_{base}", number + 1
        folder.mkdir(parents=True, exist_ok=True)
        target.write_bytes(self._read(entry))
        return target

    def _read(self, entry: str) -> bytes:
        """Return the content of an entry, which may be damaged, encrypted or compressed in a way that is not known."""
        if (size := self._content.getinfo(entry).file_size) > MAX_BYTES:
            raise InvalidConfig(f"{self.path}: {entry} would take {size:,} bytes; at most {MAX_BYTES:,} are allowed")
        try:
            return self._content.read(entry)
        except (zipfile.BadZipFile, RuntimeError, EOFError, zlib.error) as error:
            raise InvalidConfig(f"{self.path}: {entry} cannot be read: {error}") from None

    def _find(self, name: str) -> str:
        """Return the name of the entry that a URI names; a path that leads outside of the archive is none."""
        for text in (unquote(name), name):  # some tools do not encode it
            entry = str(PurePosixPath(text.removeprefix("./")))
            if entry in self._names:
                return entry
        raise InvalidConfig(f"{self.path} has no {name!r}; an SSP file contains all that it names")


@contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open an SSP file.

    Raises:
        InvalidConfig: there is no such file, or it is no SSP file.
    """
    check_user_file(path, expected="an SSP file")
    try:
        with zipfile.ZipFile(path) as content:
            if STRUCTURE not in content.namelist():
                raise InvalidConfig(f"{path} is no SSP file: it has no {STRUCTURE}")
            yield Archive(path, content)
    except zipfile.BadZipFile:
        raise InvalidConfig(f"{path} is no SSP file: it is not a ZIP file") from None
