"""What the terminal shows of a sweep: ours, the paper's, the difference, and which identities hold."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from jaxlens.experiments import paper
from jaxlens.experiments.reports import new_table
from jaxlens.metrics import METRICS

_DECIMALS = {"snr": 3, "psnr": 3, "rmse": 3, "mae": 3}
# A longer table shows the paper's lenses only.
_MOST_ROWS = 12
_UNPUBLISHED = (
    "The paper does not publish its picture, so its numbers cannot be met digit by digit: ours are those of another "
    "picture. What can be checked are the relations between the numbers, below."
)
# Relative: identities of sums in single precision.
_ROUNDING = 1e-5


def comparison(kappa: np.ndarray, scores: Mapping[str, np.ndarray], *, peak: float, title: str) -> list[RenderableType]:
    """Returns the table of ours beside the paper's, its footnote, and the identities of both."""
    table = new_table(title)
    table.add_column("κ1, κ2", vertical="top")
    table.add_column("")
    for metric in paper.METRICS:
        table.add_column(f"{METRICS[metric].label}\n{METRICS[metric].unit}", justify="right")
    copied = False
    for index, one in enumerate(kappa):
        row = paper.row_of([float(value) for value in one])
        if row is None and len(kappa) > _MOST_ROWS:
            continue
        ours = {metric: float(scores[metric][index]) for metric in paper.METRICS}
        names, columns = ["ours"], {metric: [_number(ours[metric], metric)] for metric in paper.METRICS}
        if row is not None:
            names += ["paper", "difference"]
            for metric in paper.METRICS:
                theirs = getattr(row, metric)
                mark = "*" if row.copied and metric in ("rmse", "mae") else ""
                columns[metric] += [
                    _number(theirs, metric) + mark,
                    f"{ours[metric] - theirs:+.{_DECIMALS[metric]}f}" + mark,
                ]
            copied |= row.copied
        label = ", ".join(f"{value:g}" for value in one)
        table.add_row(
            label, "\n".join(names), *("\n".join(columns[metric]) for metric in paper.METRICS), end_section=True
        )
    parts: list[RenderableType] = [table]
    parts.append(Text(_UNPUBLISHED, style="dim"))
    if copied:
        parts.append(Text(_footnote(), style="dim"))
    return [*parts, identities(kappa, scores, peak=peak)]


def _footnote() -> str:
    row = next(row for row in paper.TABLE_1 if row.copied)
    return (
        f"* In row (2, 3) the paper repeats RMSE and MAE of row (1, 2). Its own PSNR there implies an RMSE of "
        f"{paper.implied_rmse(row.psnr):.3f}."
    )


def identities(kappa: np.ndarray, scores: Mapping[str, np.ndarray], *, peak: float) -> Table:
    """Returns which relations between the columns hold, in the paper's table and in ours."""
    theirs = {metric: np.array([getattr(row, metric) for row in paper.TABLE_1]) for metric in paper.METRICS}
    their_kappa = [row.kappa for row in paper.TABLE_1]
    our_kappa = [tuple(float(value) for value in one) for one in kappa]
    table = new_table("Identities")
    for name in ("", "paper", "ours"):
        table.add_column(name, vertical="top")
    both = ((their_kappa, theirs, paper.PEAK), (our_kappa, scores, peak))
    table.add_row("RMSE · 10^(PSNR/20) = peak", *(_peak(lenses, one, level) for lenses, one, level in both))
    table.add_row("PSNR − SNR is constant", *(_offset(one, level) for _, one, level in both))
    table.add_row("PSNR falls along (0, 1), (1, 2), (1, 3), (2, 3)", *(_falls(lenses, one) for lenses, one, _ in both))
    table.add_row("PSNR of (3, 1) against (3, 2)", *(_last_two(lenses, one) for lenses, one, _ in both))
    return table


def _peak(kappa: Sequence[tuple[float, ...]], scores: Mapping[str, np.ndarray], peak: float) -> str:
    psnr, rmse = np.asarray(scores["psnr"]), np.asarray(scores["rmse"])
    # Without an error, RMSE is 0 and PSNR infinite, and there is nothing to tie.
    finite = np.flatnonzero(np.isfinite(psnr))
    implied = rmse[finite] * 10 ** (psnr[finite] / 20)
    wrong = np.flatnonzero(~np.isclose(implied, peak, rtol=_ROUNDING, atol=0))
    if not len(implied):
        return "no finite row"
    if not len(wrong):
        return f"yes, {peak:.3f} in all {len(implied)} rows"
    places = ", ".join(f"{_pair(kappa[int(finite[index])])}: {implied[index]:.3f}" for index in wrong[:3])
    return f"{peak:.3f} in {len(implied) - len(wrong)} of {len(implied)} rows; not in {places}"


def _offset(scores: Mapping[str, np.ndarray], peak: float) -> str:
    psnr, snr = np.asarray(scores["psnr"]), np.asarray(scores["snr"])
    finite = np.isfinite(psnr) & np.isfinite(snr)
    offset = psnr[finite] - snr[finite]
    if not len(offset):
        return "no finite row"
    mean = float(offset.mean())
    if np.abs(offset - mean).max() > _ROUNDING * max(1.0, abs(mean)):
        return f"no, from {offset.min():.5f} to {offset.max():.5f} dB"
    return f"yes, {mean:.5f} dB: the image's root of mean square is {paper.root_mean_square(mean, peak):.3f}"


def _falls(kappa: Sequence[tuple[float, ...]], scores: Mapping[str, np.ndarray]) -> str:
    values = [_of(kappa, scores, one) for one in paper.FALLING]
    if any(value is None for value in values):
        return "rows missing"
    known = [value for value in values if value is not None]
    text = " > ".join(f"{value:.2f}" for value in known)
    falls = all(a > b for a, b in itertools.pairwise(known))
    return f"yes, {text}" if falls else "no, " + text.replace(" > ", ", ")


def _last_two(kappa: Sequence[tuple[float, ...]], scores: Mapping[str, np.ndarray]) -> str:
    weaker, stronger = _of(kappa, scores, (3.0, 1.0)), _of(kappa, scores, (3.0, 2.0))
    if weaker is None or stronger is None:
        return "rows missing"
    relation = "below" if weaker < stronger else "above"
    return f"{relation}, by {abs(weaker - stronger):.3f} dB"


def _of(
    kappa: Sequence[tuple[float, ...]], scores: Mapping[str, np.ndarray], wanted: tuple[float, ...]
) -> float | None:
    return next((float(value) for one, value in zip(kappa, scores["psnr"], strict=True) if one == wanted), None)


def extremes(kappa: np.ndarray, scores: Mapping[str, np.ndarray], *, title: str) -> list[RenderableType]:
    """Returns a short table: each metric's least and greatest value, and the lenses that have them."""
    table = new_table(title)
    table.add_column("1 lens" if len(kappa) == 1 else f"{len(kappa)} lenses", no_wrap=True)
    for name in ("least", "at κ", "greatest", "at κ"):
        table.add_column(name, justify="right")
    for metric, column in scores.items():
        if not np.isnan(column).all():
            low, high = int(np.nanargmin(column)), int(np.nanargmax(column))
            least, greatest = (f"{column[index]:.6g}".replace("inf", "∞") for index in (low, high))
            table.add_row(metric, least, _pair(kappa[low]), greatest, _pair(kappa[high]))
    return [table]


def _pair(kappa: Sequence[float] | np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in kappa) + ")"


def _number(value: float, metric: str) -> str:
    return f"{value:.{_DECIMALS[metric]}f}".replace("inf", "∞")
