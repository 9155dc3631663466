"""Tables in CSV files."""

import csv
from pathlib import Path


def csv_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file below its header, each by the names of the columns."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
