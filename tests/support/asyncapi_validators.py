"""AsyncAPI's own validators: the JSON schema of the specification, and the parser of the AsyncAPI Initiative.

The parser is a program for Node.js, which not every machine has. It is installed once, in a folder of the user's cache.
"""

import functools
import gzip
import hashlib
import json
import shutil
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from platformdirs import user_cache_path

FILES = Path(__file__).parent / "asyncapi"
_PACKAGE = ("package.json", "package-lock.json", "validate.mjs")
_SEVERE = (0, 1)
"""Errors and warnings of the parser; the rest is advice, such as to use a newer version of the standard."""


def schema_validator() -> jsonschema.Draft7Validator:
    """Return a validator of documents of AsyncAPI 3.0.0; it does not follow references within the document."""
    schema = gzip.decompress((FILES / "asyncapi-3.0.0.json.gz").read_bytes())
    return jsonschema.Draft7Validator(json.loads(schema))


def parser_problems(document: Path) -> list[dict[str, Any]]:
    """Return the errors and warnings of the parser; skip the test where the parser is not to be had."""
    program = _parser() / "validate.mjs"
    done = subprocess.run(["node", str(program), str(document)], capture_output=True, text=True, check=True)
    return [problem for problem in json.loads(done.stdout) if problem["severity"] in _SEVERE]


@functools.cache
def _parser() -> Path:
    """Return the folder in which the parser is installed, with the digests of `package-lock.json`."""
    instead = "so only the JSON schema of the specification validates the document"
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip(f"Node.js is not installed, {instead}; on Debian: apt install nodejs npm")
    version = hashlib.sha256(b"".join((FILES / name).read_bytes() for name in _PACKAGE)).hexdigest()[:16]
    folder = user_cache_path("zenostat") / "tests" / f"asyncapi-parser-{version}"
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            package = Path(scratch, "package")
            package.mkdir()
            for name in _PACKAGE:
                shutil.copy(FILES / name, package)
            install = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
            done = subprocess.run(install, cwd=package, capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"npm cannot install AsyncAPI's parser, {instead}: {done.stderr.strip()[-300:]}")
            with suppress(OSError):  # another process of the tests was faster
                package.rename(folder)
    return folder
