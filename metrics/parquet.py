"""Write a table as a Parquet file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.extras import import_extra


def write_table(
    table: Mapping[str, NDArray[Any]], units: Mapping[str, str], metadata: Mapping[str, str], path: Path
) -> None:
    """Write columns of equal length by name, with the units of some of them in the metadata of their fields.

    Raises:
        InvalidConfig: pyarrow is not installed.
    """
    arrow = import_extra("pyarrow", "parquet", "a Parquet file")
    parquet = import_extra("pyarrow.parquet", "parquet", "a Parquet file")
    fields, columns = [], []
    for name, values in table.items():
        column = arrow.array(values.tolist()) if values.dtype.kind == "U" else arrow.array(values)
        if values.dtype.kind == "U":
            column = column.dictionary_encode()
        columns.append(column)
        fields.append(arrow.field(name, column.type, metadata={"unit": units[name]} if name in units else None))
    schema = arrow.schema(fields, metadata=metadata)
    floats = [name for name, values in table.items() if values.dtype.kind == "f"]
    others = [name for name in table if name not in floats]
    with atomic_file(path) as temporary, temporary.open("wb") as file:  # pyarrow takes only names in UTF-8
        parquet.write_table(
            arrow.Table.from_arrays(columns, schema=schema),
            file,
            compression="zstd",
            use_dictionary=others,
            use_byte_stream_split=floats,
        )
