"""Fitting a lens, or any coordinate map, to correspondences: ideal points, and where they were observed."""

from functools import partial

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float, PyTree

from jaxlens.fitting._arguments import (
    Bounds,
    Static,
    as_weights,
    bound_vectors,
    check_count,
    check_finite,
    check_loss,
    check_solver,
    common_dtype,
)
from jaxlens.fitting._parameters import Choice, Selection, choose, free_mask, in_dtype
from jaxlens.fitting._problem import Problem, assess, minimize, report
from jaxlens.fitting._result import Fit, checked
from jaxlens.fitting._robust import Loss
from jaxlens.fitting._solver import Unknowns
from jaxlens.frames import Frame
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import as_points


class _Points(Problem):
    selection: Selection
    frame: Frame
    ideal: Float[Array, "points 2"]
    observed: Float[Array, "points 2"]
    weights: Float[Array, "1 points"]
    fused = True

    def residuals(self, unknowns: Unknowns) -> Float[Array, "1 points 2"]:
        model = self.selection.insert(unknowns.shared)
        predicted = self.frame.zoomed(model["scale"]).denormalize(model["lens"](self.ideal))
        used = (self.weights[0] > 0)[:, None]
        return jnp.where(used, self.observed - predicted, 0)[None]


def fit_points(
    lens: CoordinateMap,
    ideal: Float[ArrayLike, "points 2"],
    observed: Float[ArrayLike, "points 2"],
    *,
    frame: Frame | None = None,
    weights: Float[ArrayLike, " points"] | None = None,
    free: PyTree | None = None,
    center: bool = False,
    scale: bool = False,
    bounds: Bounds | None = None,
    loss: Loss = "linear",
    loss_scale: Float[ArrayLike, ""] | None = None,
    max_steps: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    throw: bool = True,
) -> Fit:
    """Finds the lens that takes ideal points to observed ones: `observed ≈ frame.denormalize(lens.distort(ideal))`.

    Args:
        lens: Where to start; its class and number of coefficients are the model. Any coordinate map will do: a
            lens, a deformation, a chain of them.
        ideal: `(N, 2)` normalized points, (x, y) order.
        observed: `(N, 2)` where they are seen: normalized too, or in pixels if there is a `frame`.
        frame: Between normalized coordinates and `observed`; none if that is normalized.
        weights: `(N,)`, inverse variances up to a common factor. Points of weight zero do not count, and may be NaN.
        free: Which numbers of the lens are fitted: a pytree of the lens's structure, with a boolean, or an array of
            booleans, for each of its arrays. `lens.adjustable()`, unless given: all but a centre of distortion.
        center: Fit the lens's centre of distortion, too.
        scale: Fit the frame's scale, too: one factor, called `scale`, on that of `frame`. An unknown scale needs
            ideal points whose size is known, as those of a plane or a board.
        bounds: By parameter, its smallest and largest value: `{"kappa1": (-1.0, 1.0)}`. A parameter that ends at
            its bound is still counted, and its standard error is that of a free one.
        loss: `linear` for normal noise; `huber` or `cauchy` when some points are wrong.
        loss_scale: The residual at which the loss bends, in units of a point of weight one; estimated by
            the median residual, unless given.
        max_steps: Steps of the solver, in each round of a robust loss.
        solver: A least-squares solver of optimistix in place of ours, such as `optimistix.Dogleg(1e-8, 1e-8)`. It knows
            no bounds, and its tolerances are its own. Dogleg and Gauss–Newton cannot start where a parameter has no
            effect, as the centre of a lens that distorts nothing: the status is then `RANK_DEFICIENT`.
        throw: Raise `FitError` unless the fit has converged and the data determine it. Under `jax.jit` and `jax.vmap`
            nothing is raised: look at `status`.

    Returns:
        A `Fit`, in the widest dtype among data and lens (x64 is wanted for standard errors of nearly dependent
        coefficients). Differentiable with respect to `ideal`, `observed`, `weights`, the frame and the
        fixed parameters by the implicit function theorem, where no bound is active; with a robust loss at a fixed loss
        scale. `folds` tells whether one of the ideal points lies where the lens is not one-to-one.

    Raises:
        ValueError: shapes that do not fit, points that are not finite, fewer equations than parameters.
        FitError: `throw`, and no result worth having.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> ideal = jnp.stack(jnp.meshgrid(jnp.linspace(-0.7, 0.7, 9), jnp.linspace(-0.5, 0.5, 7)), -1).reshape(-1, 2)
        >>> observed = jl.RadialPolynomial([-0.2, 0.05]).distort(ideal)
        >>> fit = jl.fitting.fit_points(jl.RadialPolynomial([0.0, 0.0]), ideal, observed)
        >>> [round(float(value), 3) for value in fit.lens.coefficients]
        [-0.2, 0.05]
    """
    check_loss(loss, loss_scale)
    check_solver(solver, bounded=bool(bounds))
    ideal, observed = as_points(ideal), as_points(observed)
    if ideal.ndim != 2 or ideal.shape != observed.shape:
        raise ValueError(
            f"ideal and observed must both have shape (N, 2), got {ideal.shape} and {observed.shape}; for a batch of "
            "fits use jax.vmap"
        )
    weights = as_weights(weights, ideal.shape[:1])
    check_finite("ideal", ideal, weights)
    check_finite("observed", observed, weights)
    mask = free_mask(lens, free, center=center)
    choice = choose({"lens": lens, "scale": 1.0}, {"lens": mask, "scale": scale})
    check_count(2, weights, choice.names, "points")
    fit = _fit(
        choice,
        lens,
        frame,
        ideal,
        observed,
        weights,
        bound_vectors(bounds, choice.names),
        loss_scale,
        loss=loss,
        max_steps=max_steps,
        solver=Static(solver),
    )
    return checked(fit, throw)


@partial(jax.jit, static_argnames=("choice", "loss", "max_steps", "solver"))
def _fit(choice: Choice, lens, frame, ideal, observed, weights, bounds, loss_scale, *, loss, max_steps, solver) -> Fit:
    dtype = common_dtype(lens, ideal, observed)
    frame = Frame(jnp.zeros(2), jnp.ones(2)) if frame is None else frame
    frame, ideal, observed, weights, bounds, loss_scale = in_dtype(
        (frame, ideal, observed, weights, bounds, loss_scale), dtype
    )
    selection = Selection(in_dtype({"lens": lens, "scale": 1.0}, dtype), choice)
    used = (weights > 0)[:, None]
    problem = _Points(
        selection=selection, frame=frame, ideal=jnp.where(used, ideal, 0), observed=observed, weights=weights[None]
    )
    minimum = minimize(
        problem,
        Unknowns.dense(selection.values()),
        loss=loss,
        loss_scale=loss_scale,
        bounds=bounds,
        max_steps=max_steps,
        solver=solver.tree,
    )
    known = assess(problem, minimum, loss=loss)
    model = selection.insert(minimum.unknowns.shared)
    return report(
        minimum,
        known,
        choice.names,
        lens=model["lens"],
        frame=frame.zoomed(model["scale"]),
        residuals=known.residuals[0],
        folds=jnp.any(~model["lens"].one_to_one(problem.ideal) & used[:, 0]),
    )
