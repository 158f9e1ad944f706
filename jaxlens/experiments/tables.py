"""Tables of results, and their CSV form: nine significant digits, the same bytes everywhere."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Value = str | float | int | np.number
DIGITS = 9


def write_csv(folder: Path, columns: Mapping[str, Sequence[Value] | np.ndarray], name: str = "table.csv") -> None:
    """Writes columns to a CSV file of a folder."""
    (folder / name).write_text(csv_text(columns), encoding="utf-8", newline="")


def write_rows(folder: Path, names: Sequence[str], rows: Sequence[Sequence[Value]], name: str = "table.csv") -> None:
    """Writes rows to a CSV file of a folder, under the names of their columns."""
    write_csv(folder, {one: [row[index] for row in rows] for index, one in enumerate(names)}, name)


def csv_text(columns: Mapping[str, Sequence[Value] | np.ndarray]) -> str:
    """Returns columns as CSV, with a header, numbers to nine significant digits, lines ended by a newline."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([[_cell(value) for value in row] for row in zip(*columns.values(), strict=True)])
    return buffer.getvalue()


def kappa_columns(kappa: np.ndarray) -> dict[str, np.ndarray]:
    """Returns coefficients `(lenses, order)` as columns `kappa1`, `kappa2` and so on."""
    return {f"kappa{index + 1}": column for index, column in enumerate(kappa.T)}


def _cell(value: Value) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, int | np.integer):
        return str(value)
    # Adding zero turns −0 into 0.
    return f"{float(value) + 0.0:.{DIGITS}g}"
