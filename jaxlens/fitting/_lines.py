"""Plumb lines: a lens from points that lie on straight lines in the world (Brown 1971)."""

from collections.abc import Sequence
from functools import partial
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from jaxlens.fitting._arguments import (
    Bounds,
    Static,
    as_weights,
    bound_vectors,
    check_count,
    check_loss,
    check_solver,
    common_dtype,
    is_concrete,
)
from jaxlens.fitting._parameters import Choice, Selection, choose, free_mask, in_dtype
from jaxlens.fitting._problem import Minimum, Problem, assess, descend, differentiable, report
from jaxlens.fitting._result import Fit, FitStatus, checked
from jaxlens.fitting._robust import Loss, noise_scale
from jaxlens.fitting._solver import Unknowns, jacobian_rows
from jaxlens.fitting._starts import coefficient_places, grid, search
from jaxlens.frames import Frame
from jaxlens.lenses import Lens
from jaxlens.newton import solve_small, value_and_jacobian
from jaxlens.numerics import as_floating, epsilon, join, split

# A line's own parameters, its angle and offset; with as many points it is straight whatever the lens.
_LINE = 2
# Straightness that changes by less than this share of how far the points move says nothing about the lens.
_BLIND = 1e-7
# How far, as shares of its ideal radius, the search's lenses move the outermost point; at −1/3 one term folds.
_MOVES = (-0.325, -0.3, -0.24, -0.17, -0.1, -0.04, 0.0, 0.06, 0.15, 0.3, 0.5, 0.9)
_PAIRS = [(first, second) for first in (-0.4, -0.2, -0.08, 0.1, 0.4) for second in (-0.2, -0.07, 0.07, 0.2, 0.5)]
# Residuals this small against the picture are rounding; neighbours that agree by so many standard errors, no chance.
_ROUNDING, _CHANCE = 0.6, 4.0


class _Lines(Problem):
    selection: Selection
    frame: Frame
    points: Float[Array, "lines points 2"]
    line_weights: Float[Array, "lines points"]
    weights: Float[Array, "1 all_points"]

    def residuals(self, unknowns: Unknowns) -> Float[Array, "1 all_points 1"]:
        lens = self.selection.insert(unknowns.shared)
        ideal = self.ideal(unknowns)
        # How far a point of the picture must move for its ideal point to move by one: the straight line's curve in
        # the picture is as far from the point as the line from the ideal point, over the length of this gradient.
        # Distances there cannot shrink to zero with the ideal points.
        jacobian = jnp.swapaxes(value_and_jacobian(lens.distort, ideal)[1], -1, -2)

        def per_pixel(normal):
            x, y = split(solve_small(jacobian, jnp.broadcast_to(normal[:, None], ideal.shape)))
            return jnp.hypot(x / self.frame.scale[0], y / self.frame.scale[1])

        normal, middle = _line(ideal, self.line_weights)
        normal, middle = _line(ideal, self.line_weights / per_pixel(normal) ** 2)
        distance = jnp.sum((ideal - middle[:, None]) * normal[:, None], axis=-1) / per_pixel(normal)
        return jnp.where(self.line_weights > 0, distance, 0).reshape(1, -1, 1)

    def ideal(self, unknowns: Unknowns) -> Float[Array, "lines points 2"]:
        """Returns the undistorted points, normalized; the edge of what the lens sees for points beyond it."""
        return self.selection.insert(unknowns.shared).invert(self.frame.normalize(self.points)).points


def _line(points: Float[Array, "lines points 2"], weights: Float[Array, "lines points"]) -> tuple[Array, Array]:
    """Returns the unit normal of each line of least squared distances, and the middle of its points."""
    total = jnp.sum(weights, axis=1)
    middle = jnp.sum(weights[..., None] * points, axis=1) / total[:, None]
    x, y = split(points - middle[:, None])
    along, across = jnp.sum(weights * (x * x - y * y), axis=1), 2 * jnp.sum(weights * x * y, axis=1)
    angle = 0.5 * jnp.arctan2(across, along)
    return join(-jnp.sin(angle), jnp.cos(angle)), middle


def fit_lines(
    lens: Lens,
    lines: Sequence[ArrayLike] | Float[ArrayLike, "lines points 2"],
    *,
    frame: Frame | None = None,
    weights: Float[ArrayLike, "lines points"] | None = None,
    free: PyTree | None = None,
    center: bool = False,
    search: bool = True,
    bounds: Bounds | None = None,
    loss: Loss = "linear",
    loss_scale: Float[ArrayLike, ""] | None = None,
    max_steps: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    throw: bool = True,
) -> Fit:
    """Finds the lens that makes lines straight again: plumb-line calibration, without a known target.

    The residual of a point is its distance, in the picture, from the curve that the lens makes of its straight line
    (to first order). Each line's angle and offset are eliminated in closed form.

    Args:
        lens: Where to start; its class and number of coefficients are the model.
        lines: Observed points, a list of `(n, 2)` arrays, one a line; or an array `(L, N, 2)` in which NaN
            marks missing points (the form for `jax.vmap`, with `weights` to mark them under `jax.jit`). At least three
            a line.
        frame: Between normalized coordinates and the points' pixels; none if they are normalized.
        weights: `(L, N)` inverse variances up to a common factor, for the array form.
        free: As in `fit_points`.
        center: Fit the lens's centre of distortion, too.
        search: Look for the start by a grid over the first two coefficients, and take the others up one by one;
            otherwise start at `lens`, with all of them.
        bounds: As in `fit_points`.
        loss: As in `fit_points`. A point that is far off tilts its whole line, whatever the loss: leave gross outliers
            out, for with them the standard errors are too small.
        loss_scale: As in `fit_points`.
        max_steps: As in `fit_points`.
        solver: As in `fit_points`; it takes the last way, from what the search has found.
        throw: As in `fit_points`.

    Returns:
        A `Fit`. Its `residuals` `(L, N, 1)` are distances in the units of the points (pixels, with a frame), its
        degrees of freedom count two parameters a line. Lines that pass through the centre of distortion stay straight
        under every radial lens: if all do, the status is `RANK_DEFICIENT`.

    Raises:
        ValueError: lines of fewer than three points, points that are not finite, fewer points than parameters.
        FitError: `throw`, and no result worth having.
    """
    check_loss(loss, loss_scale)
    check_solver(solver, bounded=bool(bounds))
    points, weights = _padded(lines, weights)
    choice = choose(lens, free_mask(lens, free, center=center))
    check_count(1, weights, choice.names, "points on lines", _LINE * points.shape[0])
    fit = _fit(
        choice,
        lens,
        frame,
        points,
        weights,
        bound_vectors(bounds, choice.names),
        loss_scale,
        searches=search and bool(coefficient_places(choice.names)),
        loss=loss,
        max_steps=max_steps,
        solver=Static(solver),
    )
    return checked(fit, throw)


@partial(jax.jit, static_argnames=("choice", "searches", "loss", "max_steps", "solver"))
def _fit(choice: Choice, lens, frame, points, weights, bounds, loss_scale, *, searches, loss, max_steps, solver) -> Fit:
    dtype = common_dtype(lens, points)
    frame = Frame(jnp.zeros(2), jnp.ones(2)) if frame is None else frame
    lens, frame, points, weights, bounds, loss_scale = in_dtype(
        (lens, frame, points, weights, bounds, loss_scale), dtype
    )
    # A point that does not count stands at its line's first: nothing there is singular.
    used = weights > 0
    filler = jnp.take_along_axis(points, jnp.argmax(used, axis=1)[:, None, None], axis=1)
    points = jnp.where(used[..., None], points, filler)
    broken = ~jnp.all(jnp.isfinite(points))
    problem = _Lines(
        selection=Selection(lens, choice),
        frame=frame,
        points=points,
        line_weights=weights,
        weights=weights.reshape(1, -1),
    )
    options = {"loss": loss, "loss_scale": loss_scale, "bounds": bounds, "max_steps": max_steps}
    fixed = lax.stop_gradient(problem)
    start = fixed.selection.values()
    if searches:
        found = _search(fixed, start, options)
        if solver.tree is not None:
            found = descend(fixed, found.unknowns, **options, solver=solver.tree)
    else:
        found = descend(fixed, Unknowns.dense(start), **options, solver=solver.tree)
    minimum = differentiable(problem, found, loss)
    known = assess(problem, minimum, loss=loss, further_parameters=_LINE * points.shape[0])
    lens = problem.selection.insert(minimum.unknowns.shared)
    blind = _blind(problem, minimum.unknowns)
    status = jnp.where(blind & (known.status_code <= FitStatus.DIVERGED), FitStatus.RANK_DEFICIENT, known.status_code)
    return report(
        minimum,
        known,
        choice.names,
        lens=lens,
        frame=frame,
        covariance=jnp.where(blind, jnp.nan, known.covariance),
        residuals=known.residuals.reshape(*weights.shape, 1),
        status_code=jnp.where(broken, FitStatus.NOT_FINITE, status),
        folds=jnp.any(~lens.invert(frame.normalize(points)).valid & used),
        noise_correlation=_neighbours(problem, minimum.unknowns, known.residuals),
    )


def _search(problem: _Lines, values: Array, options: dict) -> Minimum:
    """Returns the minimum from the best of many starts."""
    places = coefficient_places(problem.selection.choice.names)
    normalized = problem.frame.normalize(problem.points).reshape(-1, 2)
    corner = normalized[jnp.argmax(jnp.sum(normalized**2, axis=-1))]
    moves = np.asarray(_MOVES)[:, None]
    alone = grid(problem.selection.insert, values, places[:1], corner, moves, observed=True)
    alone = jnp.concatenate([values[None], alone])
    every = alone
    if len(places) > 1:
        both = grid(problem.selection.insert, values, places[:2], corner, np.asarray(_PAIRS), observed=True)
        every = jnp.concatenate([alone, both])

    def cost(unknowns, loss_scale):
        lens = problem.selection.insert(unknowns.shared)
        valid = lens.invert(problem.frame.normalize(problem.points)).valid
        rows = problem.weighted(unknowns)
        if options["loss"] == "linear":
            left = jnp.sum(rows**2)
        else:  # Of several loss scales the sums of the losses cannot be compared; the medians can.
            left = noise_scale(rows, problem.weights, options["loss"])
        # A lens that folds within the data is worse than any that does not.
        lost = jnp.any(~valid & (problem.line_weights > 0))
        left = jnp.where(lost, left * 1e12, left)
        return jnp.where(jnp.isfinite(left), left, jnp.inf)

    return search(problem, alone, every, places, cost, options)


def _neighbours(problem: _Lines, unknowns: Unknowns, residuals: Array) -> Float[Array, ""]:
    """Returns the correlation of neighbours on a line, beyond that of independent noise; 0 if chance explains it."""
    weights, ideal = problem.line_weights, problem.ideal(unknowns)
    used = weights > 0
    values = jnp.where(used, residuals.reshape(weights.shape) * jnp.sqrt(weights), 0)
    normal, middle = _line(ideal, weights)
    x, y = split(ideal - middle[:, None])
    along = jnp.where(used, normal[:, 1:] * x - normal[:, :1] * y, jnp.inf)
    order = jnp.argsort(along, axis=1)
    values, used = jnp.take_along_axis(values, order, axis=1), jnp.take_along_axis(used, order, axis=1)
    both = used[:, 1:] & used[:, :-1]
    variance = jnp.sum(values**2) / jnp.sum(used)
    pairs = jnp.sum(both)
    # The line through the points takes two of their degrees of freedom, and leaves neighbours a little opposed.
    expected = -_LINE * used.shape[0] / jnp.sum(used)
    product = jnp.sum(jnp.where(both, values[:, 1:] * values[:, :-1], 0)) / pairs
    agreement = product / jnp.where(variance > 0, variance, 1) - expected
    spread = jnp.max(jnp.where(used[..., None], jnp.abs(problem.points - problem.points[:1, :1]), 0))
    rounding = jnp.sqrt(variance) <= spread * jnp.max(jnp.sqrt(weights)) * epsilon(values.dtype) ** _ROUNDING
    return jnp.where((agreement * jnp.sqrt(pairs) > _CHANCE) & ~rounding, agreement, 0)


def _blind(problem: _Lines, unknowns: Unknowns) -> Bool[Array, ""]:
    """Tells whether some parameter moves points along their lines only."""

    def moved(unknowns):
        ideal = problem.frame.denormalize(problem.ideal(unknowns))
        return (jnp.sqrt(problem.line_weights)[..., None] * ideal).reshape(1, -1)

    bends = jacobian_rows(lambda u: problem.weighted(u)[..., 0], unknowns)[1]
    moves = jacobian_rows(moved, unknowns)[1]
    return jnp.any(jnp.sum(bends**2, axis=(0, 1)) <= _BLIND**2 * jnp.sum(moves**2, axis=(0, 1)))


def _padded(
    lines: Sequence[ArrayLike] | ArrayLike, weights: ArrayLike | None
) -> tuple[Array | np.ndarray, Array | np.ndarray]:
    """Lines as one array, with weights that are zero where a line has no point."""
    if hasattr(lines, "ndim"):
        points = as_floating(lines)
        if points.ndim != 3 or points.shape[-1] != 2:
            raise ValueError(f"lines must be a list of (n, 2) arrays, or an array (L, N, 2), got shape {points.shape}")
        given = as_weights(weights, points.shape[:2])
        if not is_concrete(points, given):
            return points, given
        points = np.asarray(points)
        given = np.where(np.isfinite(points).all(axis=-1), given, 0)
    else:
        if weights is not None:
            raise ValueError("weights belong to lines as an array (L, N, 2); leave points out of a list instead")
        arrays = [np.asarray(as_floating(line)) for line in cast(Sequence, lines)]
        for index, line in enumerate(arrays):
            if line.ndim != 2 or line.shape[1] != 2:
                raise ValueError(f"line {index} must have shape (n, 2), got {line.shape}")
            bad = ~np.isfinite(line).all(axis=1)
            if bad.any():
                where = int(np.argmax(bad))
                raise ValueError(f"line {index} is not finite at point {where}: {line[where].tolist()}; leave it out")
        if not arrays:
            raise ValueError("no lines")
        longest = max(line.shape[0] for line in arrays)
        points = np.zeros((len(arrays), longest, 2), np.result_type(*arrays))
        given = np.zeros((len(arrays), longest), points.dtype)
        for index, line in enumerate(arrays):
            points[index, : len(line)], given[index, : len(line)] = line, 1
    counts = (np.asarray(given) > 0).sum(axis=1)
    if (counts <= _LINE).any():
        index = int(np.argmax(counts <= _LINE))
        raise ValueError(
            f"line {index} has {counts[index]} points; at least 3 are needed to tell whether it is straight"
        )
    return points, given
