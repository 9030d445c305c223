"""Parquet <-> Recording. Row groups are read and written one after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from os import SEEK_END
from pathlib import Path
from typing import Any

from ..errors import LimitError, ParameterError
from .arrowtables import arrow, arrow_errors, checked_schema, read_table, tables_of
from .formats import Destination, ReadOptions, Source, WriteOptions
from .parquet_footer import ColumnChunk, column_chunks
from .tables import Import

MAGIC = b"PAR1"
_POINTER = b"version https://git-lfs"
_COLUMNS = 1 << 16
_FOOTER_SIZE = 1 << 25
"""Bytes of a footer, checked before it is read: 100 000 columns of a row group have about 10 MB."""


def read(source: Source, options: ReadOptions) -> Import:
    arrow()
    return read_table(ParquetTable(source.path, options.max_memory), options, "Parquet")


def write(recording: Any, target: Destination, options: WriteOptions) -> list[str]:
    """A column for each channel, behind their times in s; empty cells in gaps."""
    arrow()
    from pyarrow import parquet

    schema, batches, notes = tables_of(recording, ".parquet", options)
    with (
        arrow_errors("the table cannot be written"),
        parquet.ParquetWriter(
            target.stream, schema, compression="zstd", write_page_checksum=True
        ) as writer,
    ):  # fmt: skip
        for batch in batches:
            writer.write_batch(batch)
    return notes


class ParquetTable:
    """The rows first_row <= row < stop_row of a Parquet file; None: to the end."""

    def __init__(
        self, path: Path, max_memory: int, first_row: int = 0, stop_row: int | None = None
    ) -> None:
        from pyarrow import parquet

        self._path = path
        self._max_memory = max_memory
        check_footer(path)
        with arrow_errors("this is not a Parquet file"):
            self._metadata = parquet.read_metadata(str(path))
            self.schema: Any = checked_schema(self._open().schema_arrow)
            groups = self._metadata.num_row_groups
            sizes = [self._metadata.row_group(i).num_rows for i in range(groups)]
        if min(sizes, default=0) < 0 or sum(sizes) != self._metadata.num_rows:
            raise ParameterError("the row groups have other numbers of rows than the file")
        if self._metadata.num_columns > _COLUMNS:
            raise LimitError(f"the file has more than {_COLUMNS} columns")
        self._sizes = sizes
        self.first_row = first_row
        self.stop_row = sum(sizes) if stop_row is None else stop_row
        if not 0 <= first_row <= self.stop_row <= sum(sizes):
            raise ParameterError(f"the file has {sum(sizes)} rows, not {self.stop_row}")

    @property
    def row_count(self) -> int:
        return self.stop_row - self.first_row

    def rows(self, first_row: int, stop_row: int) -> ParquetTable:
        """Some of the rows."""
        return ParquetTable(self._path, self._max_memory, first_row, stop_row)

    def _open(self) -> Any:
        from pyarrow import parquet

        return parquet.ParquetFile(
            str(self._path), memory_map=True, pre_buffer=False, page_checksum_verification=True
        )

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[Any]:
        at = 0
        with arrow_errors("the table cannot be read"):
            file = self._open()
        with file:
            for group, size in enumerate(self._sizes):
                first, last = max(self.first_row - at, 0), min(self.stop_row - at, size)
                at += size
                if first >= last:
                    continue
                self._check(group, columns)
                seen = 0
                with arrow_errors("the table cannot be read"):
                    for batch in file.iter_batches(
                        batch_size=rows, row_groups=[group], columns=list(columns),
                        use_threads=False,
                    ):  # fmt: skip
                        low, high = max(first - seen, 0), min(last - seen, batch.num_rows)
                        seen += batch.num_rows
                        if low < high:
                            yield batch.slice(low, high - low)
                        if seen >= last:
                            break
                if seen < last:
                    raise ParameterError(f"a row group ends after {seen} of {size} rows")

    def _leaves(self, column: str) -> Iterator[int]:
        """The numbers of the primitive columns of a column."""
        schema = self._metadata.schema
        for number in range(self._metadata.num_columns):
            path = schema.column(number).path
            if path == column or path.startswith(f"{column}."):
                yield number

    @cached_property
    def _chunks(self) -> list[list[ColumnChunk]]:
        found = column_chunks(read_footer(self._path))
        if [len(group) for group in found] != [self._metadata.num_columns] * len(self._sizes):
            raise ParameterError("the row groups have other columns than the schema")
        return found

    def _check(self, group: int, columns: Sequence[str]) -> None:
        """LimitError where a page could be larger than the memory allowed."""
        for column in columns:
            for number in self._leaves(column):
                size = self._chunks[group][number].size
                if size > self._max_memory:
                    raise LimitError(
                        f"column {column!r} takes {size} bytes in a row group, more than the "
                        f"{self._max_memory} allowed; allow more (max_memory=)"
                    )

    def may_lack(self, column: str) -> bool:
        field = self.schema.field(column)
        if not field.nullable and not field.type.num_fields:
            return False
        leaves = list(self._leaves(column))
        return any(group[number].nulls != 0 for group in self._chunks for number in leaves)


def read_footer(path: Path) -> bytes:
    """The footer of a file that :func:`check_footer` has seen."""
    with path.open("rb") as stream:
        stream.seek(-8, SEEK_END)
        length = int.from_bytes(stream.read(4), "little")
        stream.seek(-8 - length, SEEK_END)
        return stream.read(length)


def check_footer(path: Path) -> None:
    """The magic at both ends, and the size of the footer."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(len(_POINTER))
        if head == _POINTER:
            raise ParameterError("this is a pointer of Git LFS; git lfs pull fetches the file")
        if head[:4] == b"PARE":
            raise ParameterError("the file is encrypted")
        if size < 12 or head[:4] != MAGIC:
            raise ParameterError("this is not a Parquet file")
        stream.seek(size - 8)
        tail = stream.read(8)
    length = int.from_bytes(tail[:4], "little")
    if tail[4:] != MAGIC or length > size - 12:
        raise ParameterError("the Parquet file is truncated: it has no footer")
    if length > _FOOTER_SIZE:
        raise LimitError(f"the footer has {length} bytes, more than {_FOOTER_SIZE}")
