"""Tables of results for the page: CSV files, and the paper's Table 1 beside ours."""

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jaxlens.experiments import paper

# A table with more rows is folded; of one with many more, only the first are shown.
_OPEN_ROWS = 12
_MOST_ROWS = 60
_DIGITS = 6
_DECIMALS = 3
_UNITS = {"px": "px", "db": "dB"}
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        title: Its name as people write it.
        unit: May be empty.
        numeric: All its cells are numbers.
    """

    title: str
    unit: str
    numeric: bool


@dataclass(frozen=True)
class CsvTable:
    """A CSV file as the page shows it.

    Attributes:
        file: The file's name.
        caption: What it says; may be empty.
        columns: In their order.
        rows: The cells that are shown, as text.
        length: How many rows the file has.
    """

    file: str
    caption: str
    columns: list[Column]
    rows: list[list[str]]
    length: int

    @property
    def folded(self) -> bool:
        """Whether it is too long to lie open."""
        return self.length > _OPEN_ROWS


@dataclass(frozen=True)
class Comparison:
    """Lenses of the paper's Table 1, ours beside the paper's, and the difference.

    Attributes:
        columns: The metrics.
        rows: Of each lens the coefficients, and the cells of its three lines by name.
        copied: Rows in which the paper prints another row's numbers, with the RMSE that their own PSNR implies.
    """

    columns: list[Column]
    rows: list[tuple[str, dict[str, list[str]]]]
    copied: list[tuple[str, str]]


def csv_table(path: Path, caption: str) -> CsvTable | None:
    """Returns a CSV file as a table; None of a file that is none."""
    header, rows = _read_csv(path)
    if not header:
        return None
    numeric = [all(_is_number(row[index]) for row in rows) for index in range(len(header))]
    shown = rows if len(rows) <= _MOST_ROWS else rows[:_OPEN_ROWS]
    columns = [Column(*heading(name), right) for name, right in zip(header, numeric, strict=True)]
    cells = [[_cell(value, right) for value, right in zip(row, numeric, strict=True)] for row in shown]
    return CsvTable(path.name, caption, columns, cells, len(rows))


def comparison(path: Path) -> Comparison | None:
    """Returns the rows of a sweep's table that Table 1 has beside the paper's; None where there are none."""
    header, rows = _read_csv(path)
    if not {"kappa1", "kappa2", *paper.METRICS} <= set(header):
        return None
    ours = [dict(zip(header, values, strict=True)) for values in rows]
    pairs = [(row, one) for one in ours if (row := _row_of(one)) is not None]
    if not pairs:
        return None
    return Comparison(
        [Column(*heading(metric), True) for metric in paper.METRICS],
        [(_label(row), _compared(row, one)) for row, one in pairs],
        [(_label(row), f"{paper.implied_rmse(row.psnr):.{_DECIMALS}f}") for row, _ in pairs if row.copied],
    )


def heading(name: str) -> tuple[str, str]:
    """Returns a column's name as people write it, and its unit.

    Example:
        >>> heading("kappa1"), heading("held_out_rms"), heading("bend_of_curve_px"), heading("psnr")
        (('κ₁', ''), ('held out RMS', ''), ('bend of curve', 'px'), ('PSNR', 'dB'))
    """
    # With JAX behind it, which a mistake in a configuration does not wait for.
    from jaxlens.metrics import METRICS

    if name in METRICS:
        return METRICS[name].label, METRICS[name].unit
    words = name.split("_")
    unit = _UNITS[words.pop()] if len(words) > 1 and words[-1] in _UNITS else ""
    labels = [METRICS[word].label if word in METRICS else word.replace("rms", "RMS") for word in words]
    return re.sub(r"\bkappa(\d+)\b", lambda match: "κ" + match[1].translate(_SUBSCRIPTS), " ".join(labels)), unit


def _read_csv(path: Path) -> tuple[list[str], list[list[str]]]:
    """The header and the rows of a CSV file; of a file that is none, nothing."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = list(csv.reader(file)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error):
        return [], []
    return header, [row for row in rows if len(row) == len(header)]


def _row_of(ours: Mapping[str, str]) -> paper.Row | None:
    # A sweep over more coefficients has no row there, unless they are zero.
    names = [name for name in ours if re.fullmatch(r"kappa\d+", name)]
    try:
        kappa = [float(ours[name]) for name in sorted(names, key=lambda name: int(name[5:]))]
    except ValueError:
        return None
    return None if any(kappa[2:]) else paper.row_of(kappa[:2])


def _label(row: paper.Row) -> str:
    return ", ".join(f"{one:g}" for one in row.kappa)


def _compared(row: paper.Row, ours: Mapping[str, str]) -> dict[str, list[str]]:
    lines: dict[str, list[str]] = {"ours": [], "paper": [], "difference": []}
    for metric in paper.METRICS:
        mine, theirs = _number(ours[metric]), getattr(row, metric)
        mark = "*" if row.copied and metric in ("rmse", "mae") else ""
        lines["ours"].append(_minus(f"{mine:.{_DECIMALS}f}"))
        lines["paper"].append(_minus(f"{theirs:.{_DECIMALS}f}{mark}"))
        lines["difference"].append(_minus(f"{mine - theirs:+.{_DECIMALS}f}{mark}"))
    return lines


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _is_number(text: str) -> bool:
    return text.lower() == "nan" or not math.isnan(_number(text))


def _cell(text: str, numeric: bool) -> str:
    if not numeric:
        return text
    value = _number(text)
    if math.isnan(value):
        return "–"
    return _minus(text if re.fullmatch(r"-?\d+", text) else f"{value:.{_DIGITS}g}")


def _minus(text: str) -> str:
    return text.replace("-", "−").replace("inf", "∞")
