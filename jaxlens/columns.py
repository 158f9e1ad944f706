"""Columns of numbers from CSV files, with a message that names file, line and column where they are not."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

# Rows beyond which a file is not a table of measured points.
_MOST_ROWS = 5_000_000


class ColumnsError(ValueError):
    """A file that is no table of numbers; the message names file, line and column."""


def read_columns(path: Path, required: Sequence[str], *, optional: Sequence[str] = ()) -> dict[str, list[float]]:
    """Reads columns of finite numbers.

    Args:
        path: A CSV file in UTF-8 whose first line names the columns; others than those asked for are left alone.
        required: Columns that must be there.
        optional: Columns that may be.

    Returns:
        The columns that are there, all equally long and not empty. Under the key `""` stand the numbers of the lines.

    Raises:
        ColumnsError: the file cannot be read, lacks a column, or holds what is no finite number.
    """
    name = repr(str(path))
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return _read(name, csv.reader(file), required, optional)
    except UnicodeDecodeError as error:
        raise ColumnsError(f"{name} is no CSV file in UTF-8: byte {error.start} of it is none") from error
    except csv.Error as error:
        raise ColumnsError(f"{name} is no CSV file: {error}") from error
    except OSError as error:
        raise ColumnsError(f"cannot read {name}: {error.strerror}") from error


def _read(name: str, rows, required: Sequence[str], optional: Sequence[str]) -> dict[str, list[float]]:
    header = [cell.strip() for cell in next(rows, [])]
    missing = [column for column in required if column not in header]
    if missing:
        has = f"it has {', '.join(header)}" if any(header) else "it is empty"
        raise ColumnsError(f"{name}, line 1: no column {', '.join(missing)}; {has}; needed are {', '.join(required)}")
    wanted = [column for column in (*required, *optional) if column in header]
    doubled = [column for column in wanted if header.count(column) > 1]
    if doubled:
        raise ColumnsError(f"{name}, line 1: the column {doubled[0]} is there {header.count(doubled[0])} times")
    places = {column: header.index(column) for column in wanted}
    columns: dict[str, list[float]] = {column: [] for column in ("", *wanted)}
    for row in rows:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise ColumnsError(
                f"{name}, line {rows.line_num}: {len(row)} cells, where the first line names {len(header)}"
            )
        if len(columns[""]) == _MOST_ROWS:
            raise ColumnsError(f"{name} has more than {_MOST_ROWS} rows")
        columns[""].append(float(rows.line_num))
        for column, place in places.items():
            columns[column].append(_number(name, rows.line_num, column, row[place]))
    if not columns[""]:
        raise ColumnsError(f"{name} has no rows below its first line")
    return columns


def _number(name: str, line: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ColumnsError(f"{name}, line {line}: {column} is {text!r}, which is no number") from None
    if not math.isfinite(value):
        raise ColumnsError(f"{name}, line {line}: {column} is {text!r}; leave out rows without a measured value")
    return value
