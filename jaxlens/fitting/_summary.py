"""A fit as a table of text."""

import math

import numpy as np

from jaxlens.fitting._correlated import WINDOW
from jaxlens.fitting._result import Fit, explain

# Half the width of a 95 % interval, in standard errors.
_NORMAL_95 = 1.96
# Correlations from here are worth a line.
_STRONG = 0.9


def summarize(fit: Fit) -> str:
    """Returns estimates with standard errors and intervals, then what speaks for and against them."""
    values, errors = (np.asarray(numbers, float) for numbers in (fit.values, fit.standard_errors))
    inflation = np.asarray(fit.inflation)
    rows = [("parameter", "estimate", "std. error", "95 % interval", "inflation")]
    for name, value, error, factor in zip(fit.names, values, errors, inflation, strict=True):
        digits = _decimals(error, value)
        low, high = value - _NORMAL_95 * error, value + _NORMAL_95 * error
        interval = f"{low:.{digits}f} … {high:.{digits}f}" if np.isfinite(error) else "unknown"
        spread = f"{error:.{digits}f}" if np.isfinite(error) else "unknown"
        rows.append((name, f"{value:.{digits}f}", spread, interval, f"{factor:.3g}"))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    table = [
        "  ".join(
            cell.rjust(width) if i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    table.insert(1, "─" * len(table[0]))
    facts = [
        f"{type(fit.lens).__name__}: {explain(fit)}",
        f"root mean square residual {float(fit.rms):.6g}, {int(fit.degrees_of_freedom)} degrees of freedom, "
        f"condition number {float(fit.condition_number):.3g}",
    ]
    if np.isfinite(fit.loss_scale):
        facts.append(f"robust loss, bending at residuals of {float(fit.loss_scale):.3g}")
    if fit.noise_inflation is not None:
        facts.append(_noise(np.sqrt(np.asarray(fit.noise_inflation))))
    if fit.per_view_rms is not None:
        views = np.asarray(fit.per_view_rms)
        facts.append(f"{len(views)} views, root mean square residuals from {views.min():.3g} to {views.max():.3g}")
    if fit.image_size is not None and np.isfinite(errors).all():
        facts.append(_projections(fit))
    notes = [*_strong_correlations(fit), *(f"warning: {problem}" for problem in fit.problems())]
    return "\n".join([*facts, "", *table, *([""] if notes else []), *notes])


def _projections(fit: Fit) -> str:
    """Returns how well a camera is known in the middle of its picture and in the corner where it is known least."""
    width, height = np.asarray(fit.image_size, float) - 1
    places = np.array([[width / 2, height / 2], [0, 0], [width, 0], [0, height], [width, height]])
    middle, *corners = np.asarray(fit.projection_uncertainty(places))
    seen = [value for value in corners if np.isfinite(value)]
    corner = f"to {max(seen):.2g} in a corner" if seen else "and sees nothing in the corners"
    return f"a ray's place in the picture is known to {middle:.2g} pixels in the middle, {corner} (one std. deviation)"


def _noise(factors: np.ndarray) -> str:
    """Returns what the standard errors of a fit of pictures assume, from what correlation has made of them."""
    if not np.any(factors > 1):
        return "neighbouring residuals do not agree: the noise of each pixel is taken for independent"
    return (
        f"neighbouring residuals agree: the noise is taken for independent only between windows of {WINDOW} pixels, "
        f"and the standard errors are {factors.min():.2g} to {factors.max():.2g} times those of independent pixels"
    )


def _decimals(error: float, value: float) -> int:
    """Digits behind the point: two of the standard error, or six of a value without one."""
    size = error if np.isfinite(error) and error > 1e-12 else 1e-5 * abs(value)
    return int(min(max(1 - math.floor(math.log10(size)), 0), 12)) if size > 0 else 6


def _strong_correlations(fit: Fit) -> list[str]:
    correlation = np.asarray(fit.correlation)
    pairs = [
        (abs(correlation[i, j]), f"{fit.names[i]}–{fit.names[j]} {correlation[i, j]:+.3f}")
        for i in range(len(fit.names))
        for j in range(i)
        if abs(correlation[i, j]) >= _STRONG
    ]
    if not pairs:
        return []
    strongest = [text for _, text in sorted(pairs, reverse=True)[:3]]
    return [f"strong correlations: {', '.join(strongest)}"]
