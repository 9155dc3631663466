"""The transcript of docs/mcp.md: `python tests/support/mcp_page.py` simulates it again and writes it into the page."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "mcp.md"
BEGIN, END = "<!-- transcript of examples/mcp_diagnosis.py -->", "<!-- end of the transcript -->"


def transcript() -> str:
    """Run the example, and return what it prints."""
    command = [sys.executable, str(ROOT / "examples" / "mcp_diagnosis.py")]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def transcript_of_page() -> str:
    """Return the transcript that the page has."""
    match = re.search(f"{re.escape(BEGIN)}\n\n(.*)\n\n{re.escape(END)}", PAGE.read_text("utf-8"), re.DOTALL)
    assert match is not None
    return match[1]


def main() -> None:
    """Write the transcript into the page."""
    head, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
    _, _, tail = rest.partition(END)
    PAGE.write_text(f"{head}{BEGIN}\n\n{transcript()}\n\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
