"""Tables of results as HTML: CSV files, and the paper's Table 1 beside ours."""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from jaxlens.experiments import paper
from jaxlens.experiments.gallery.html import Markup, element, link

# A table with more rows is folded; of one with many more, only the first are shown.
_OPEN_ROWS = 12
_MOST_ROWS = 60
_DIGITS = 6
_DECIMALS = 3
_UNITS = {"snr": "dB", "psnr": "dB", "rmse": "gray levels", "mae": "gray levels"}
_ACRONYMS = frozenset({"mae", "mse", "psnr", "rms", "rmse", "snr", "ssim", "uqi"})
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def read_csv(path: Path) -> tuple[list[str], list[list[str]]]:
    """Returns the header and the rows of a CSV file; of a file that is none, nothing."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = list(csv.reader(file)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error):
        return [], []
    return header, [row for row in rows if len(row) == len(header)]


def csv_table(path: Path, caption: str) -> Markup:
    """Returns a CSV file as a table; a long one is folded, a very long one cut."""
    header, rows = read_csv(path)
    if not header:
        return Markup()
    numeric = [all(_is_number(row[index]) for row in rows) for index in range(len(header))]
    shown = rows if len(rows) <= _MOST_ROWS else rows[:_OPEN_ROWS]
    file = link(path.name, path.parent.name, path.name)
    size = f"{len(rows)} rows" if len(shown) == len(rows) else f"the first {len(shown)} of {len(rows)} rows"
    about = element("p", caption + " " if caption else None, file, f" ({size})", class_="about")
    table = _table(
        [
            element("th", heading(name), scope="col", class_=_kind(right))
            for name, right in zip(header, numeric, strict=True)
        ],
        [
            [element("td", _cell(value, right), class_=_kind(right)) for value, right in zip(row, numeric, strict=True)]
            for row in shown
        ],
        label=caption or path.name,
    )
    if len(rows) <= _OPEN_ROWS:
        return element("div", about, table, class_="table")
    summary = element("summary", f"{path.stem.replace('_', ' ')}: {len(rows)} rows")
    return element("details", summary, about, table)


def comparison(path: Path) -> Markup:
    """Returns the rows of a sweep's table that Table 1 has, ours beside the paper's, and the difference."""
    header, rows = read_csv(path)
    if not {"kappa1", "kappa2", *paper.METRICS} <= set(header):
        return Markup()
    body: list[list[Markup]] = []
    copied: list[paper.Row] = []
    for values in rows:
        ours = dict(zip(header, values, strict=True))
        row = _row_of(ours)
        if row is not None:
            body += _compared(row, ours)
            copied += [row] * row.copied
    if not body:
        return Markup()
    head = [element("th", "κ₁, κ₂", scope="col"), element("th", "", scope="col")]
    head += [
        element("th", metric.upper(), element("small", _UNITS[metric]), scope="col", class_="number")
        for metric in paper.METRICS
    ]
    about = element(
        "p",
        "Ours, the paper's, and ours less the paper's. The paper does not publish its picture, so its numbers cannot "
        "be met digit by digit.",
        class_="about",
    )
    notes = [
        f"* In row ({row.kappa[0]:g}, {row.kappa[1]:g}) the paper prints another row's RMSE and MAE again. Its own "
        f"PSNR there implies an RMSE of {paper.implied_rmse(row.psnr):.3f}."
        for row in copied
    ]
    table = _table(head, body, label="Ours beside the paper's Table 1", class_="compared")
    return element("div", about, table, *(element("p", note, class_="about") for note in notes), class_="table")


def facts_table(facts: Mapping[str, object], label: str) -> Markup:
    """Returns names and values, nested ones by dotted names."""
    rows = [[element("th", name, scope="row"), element("td", value)] for name, value in _flat(facts)]
    return _table([], rows, label=label, class_="facts")


def heading(name: str) -> str:
    """Returns a column's name as people write it.

    Example:
        >>> heading("kappa1"), heading("held_out_rms"), heading("psnr")
        ('κ₁', 'held out RMS', 'PSNR')
    """
    words = [word.upper() if word in _ACRONYMS else word for word in name.split("_")]
    return re.sub(r"\bkappa(\d+)\b", lambda match: "κ" + match[1].translate(_SUBSCRIPTS), " ".join(words))


def _table(
    head: Sequence[Markup], rows: Sequence[Sequence[Markup]], *, label: str, class_: str | None = None
) -> Markup:
    """A table that scrolls by itself where it is wider than the page, by keyboard too."""
    table = element(
        "table",
        element("thead", element("tr", *head)) if head else None,
        element("tbody", *(element("tr", *row) for row in rows)),
        class_=class_,
    )
    return element("div", table, class_="scroll", role="region", aria_label=label, tabindex=0)


def _row_of(ours: Mapping[str, str]) -> paper.Row | None:
    # A sweep over more coefficients has no row there, unless they are zero.
    names = [name for name in ours if re.fullmatch(r"kappa\d+", name)]
    try:
        kappa = [float(ours[name]) for name in sorted(names, key=lambda name: int(name[5:]))]
    except ValueError:
        return None
    return None if any(kappa[2:]) else paper.row_of(kappa[:2])


def _compared(row: paper.Row, ours: Mapping[str, str]) -> list[list[Markup]]:
    lines: dict[str, list[Markup]] = {"ours": [], "paper": [], "difference": []}
    for metric in paper.METRICS:
        mine, theirs = _number(ours[metric]), getattr(row, metric)
        mark = "*" if row.copied and metric in ("rmse", "mae") else ""
        for line, text in zip(
            lines.values(),
            (f"{mine:.{_DECIMALS}f}", f"{theirs:.{_DECIMALS}f}{mark}", f"{mine - theirs:+.{_DECIMALS}f}{mark}"),
            strict=True,
        ):
            line.append(element("td", _minus(text), class_="number"))
    label = element("th", f"{row.kappa[0]:g}, {row.kappa[1]:g}", scope="rowgroup", rowspan=len(lines))
    named = [[element("th", name, scope="row"), *cells] for name, cells in lines.items()]
    return [[label, *named[0]], *named[1:]]


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


def _kind(numeric: bool) -> str | None:
    return "number" if numeric else None


def _flat(facts: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    """Names and values, one line each; a list of plain values is one line."""
    lines: list[tuple[str, str]] = []
    for key, value in facts.items():
        name = f"{prefix}{key}"
        if isinstance(value, list) and any(isinstance(one, dict) for one in value):
            value = {str(index): one for index, one in enumerate(value)}
        if isinstance(value, dict):
            lines += _flat(value, f"{name}.")
        else:
            lines.append((name, _plain(value)))
    return lines


def _plain(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_plain(one) for one in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.12g}"
    return "–" if value is None else str(value)
