"""Photometric fits: the lens that turns one picture into the other."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree, Shaped

from jaxlens.fitting._arguments import Bounds, Static, bound_vectors, check_loss, check_solver, common_dtype
from jaxlens.fitting._correlated import variance_inflation
from jaxlens.fitting._parameters import Choice, Selection, choose, free_mask, in_dtype
from jaxlens.fitting._problem import Minimum, Problem, assess, minimize, report
from jaxlens.fitting._result import Fit, FitStatus, checked
from jaxlens.fitting._robust import Loss, influence, robustify
from jaxlens.fitting._solver import Unknowns
from jaxlens.fitting._starts import coefficient_places, grid
from jaxlens.frames import Frame
from jaxlens.lenses import Lens
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import is_concrete, split
from jaxlens.pyramid import halved
from jaxlens.sampling import interpolate
from jaxlens.warping import frame_for, pixel_grid

# The coarsest level has no side shorter than this; the search happens there.
_COARSEST = 24
# How far, in units of the picture's half diagonal, the search's lenses move its corner outwards.
_MOVES = (-0.5, -0.3, -0.15, 0.0, 0.2, 0.5, 1.0, 1.7, 2.5, 3.5)
# Candidates of the search that are refined before one is chosen.
_BEST = 6
# A pixel counts if the source is known this far around its place, in pixels: so much may the estimate still move.
_MARGIN = 0.5
# Rounds at each level: what is covered depends on the lens, and is held fixed in each round.
_ROUNDS = 2
# Of the distorted picture's variance the lens explains at least so much, or it is the lens of another picture.
_EXPLAINED = 0.2
# A share of the picture that must be covered for a candidate to count.
_COVERED = 0.1


class _Images(Problem):
    selection: Selection
    frame: Frame
    output_frame: Frame
    source: Float[Array, "height width"]
    distorted: Float[Array, "new_height new_width"]
    weights: Float[Array, "1 pixels"]

    def residuals(self, unknowns: Unknowns) -> Float[Array, "1 pixels 1"]:
        model = self.selection.insert(unknowns.shared)
        places, _ = self.places(model["lens"])
        light = model["light"]
        predicted = light["gain"] * interpolate(self.source, places) + light["offset"]
        residual = (self.distorted - predicted).reshape(1, -1)
        return jnp.where(self.weights > 0, residual, 0)[..., None]

    def places(
        self, lens: CoordinateMap
    ) -> tuple[Float[Array, "new_height new_width 2"], Bool[Array, "new_height new_width"]]:
        """Returns where in the source each pixel is seen, and whether it is seen at all."""
        height, width = self.distorted.shape
        grid = pixel_grid(height, width, self.source.dtype)
        inverse = lens.invert(self.output_frame.normalize(grid))
        return self.frame.denormalize(inverse.points), inverse.valid

    def covered(self, unknowns: Unknowns) -> Bool[Array, "1 pixels"]:
        """Returns which pixels show a place inside the source."""
        places, valid = self.places(self.selection.insert(unknowns.shared)["lens"])
        height, width = self.source.shape
        x, y = split(places)
        inside = (x >= _MARGIN) & (x <= width - 1 - _MARGIN) & (y >= _MARGIN) & (y <= height - 1 - _MARGIN)
        return (inside & valid).reshape(1, -1)


def fit_images(
    lens: CoordinateMap,
    source: Shaped[ArrayLike, "height width *channels"],
    distorted: Shaped[ArrayLike, "new_height new_width *channels"],
    *,
    frame: Frame | None = None,
    output_frame: Frame | None = None,
    mask: Bool[ArrayLike, "new_height new_width"] | None = None,
    free: PyTree | None = None,
    center: bool = False,
    search: bool = True,
    bounds: Bounds | None = None,
    loss: Loss = "linear",
    loss_scale: Float[ArrayLike, ""] | None = None,
    max_steps: int = 50,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    throw: bool = True,
) -> Fit:
    """Finds the lens with which `distort_image` turns one picture into the other, from their gray values.

    Minimizes `distorted(p) − (gain · source(lens.undistort(p)) + offset)` over the pixels p that show a place inside
    the source; gain and offset are fitted, too. From coarse to fine over a pyramid: at its top a grid of lenses is
    tried (those that move the corners by −0.5 to 3.5 half diagonals), the best are refined, and the best goes down.

    Args:
        lens: The model, and where its coefficients start. Any coordinate map will do.
        source: `(H, W)` or `(H, W, C)`, the picture without the lens; any real dtype. Channels are averaged.
        distorted: `(H', W')` or `(H', W', C)`, the picture with it.
        frame: Between normalized coordinates and the source's pixels; Eq. 10's unless given.
        output_frame: The same for the distorted picture; that of the source unless given.
        mask: `(H', W')`, true where the distorted picture is to be believed.
        free: As in `fit_points`.
        center: Fit the lens's centre of distortion, too.
        search: Look for the start by a grid over the first two coefficients of a lens; otherwise, and for other maps,
            start at `lens`.
        bounds: As in `fit_points`; `gain` and `offset` are parameters, too.
        loss: `linear` for noise; `huber` or `cauchy` where parts of the picture are covered by something else (which
            still draws gain and offset a little).
        loss_scale: As in `fit_points`, in gray values.
        max_steps: Steps of the solver at each level, in each round.
        solver: As in `fit_points`.
        throw: As in `fit_points`.

    Returns:
        A `Fit`; its `residuals` `(H', W', 1)` are gray values, zero where nothing is covered. Where the
        residuals of neighbouring pixels agree, as those of a compressed or resampled picture do, the standard
        errors are those of noise that is independent only between windows of 16 pixels, and `noise_inflation`
        says what that makes of the variances. Differentiable in both pictures by the implicit function theorem.

    Raises:
        ValueError: shapes that do not fit, pictures that are not finite or without contrast.
        FitError: `throw`, and no result worth having.

    Example:
        >>> import jax, jaxlens as jl
        >>> noise = jax.random.uniform(jax.random.key(0), (12, 16))
        >>> source = jax.image.resize(noise, (96, 128), "cubic")
        >>> fit = jl.fitting.fit_images(jl.Division(0.0), source, jl.distort_image(source, jl.Division(0.3)))
        >>> round(float(fit.lens.k), 3)
        0.3
    """
    check_loss(loss, loss_scale)
    check_solver(solver, bounded=bool(bounds))
    source, distorted = jnp.asarray(source), jnp.asarray(distorted)
    for name, image in (("source", source), ("distorted", distorted)):
        _check_image(name, image)
    if mask is not None and jnp.shape(mask) != distorted.shape[:2]:
        raise ValueError(f"mask must have the distorted picture's shape {distorted.shape[:2]}, got {jnp.shape(mask)}")
    light = {"gain": 1.0, "offset": 0.0}
    chosen = free_mask(lens, free, center=center)
    choice = choose({"lens": lens, "light": light}, {"lens": chosen, "light": {"gain": True, "offset": True}})
    if len(choice.names) == len(light):
        raise ValueError("nothing to fit: `free` names no parameter")
    frame = frame_for(lens, *source.shape[:2]) if frame is None else frame
    fit = _fit(
        choice,
        lens,
        frame,
        frame if output_frame is None else output_frame,
        source,
        distorted,
        mask,
        bound_vectors(bounds, choice.names),
        loss_scale,
        search=search and isinstance(lens, Lens),
        loss=loss,
        max_steps=max_steps,
        solver=Static(solver),
    )
    return checked(fit, throw)


@partial(jax.jit, static_argnames=("choice", "search", "loss", "max_steps", "solver"))
def _fit(
    choice: Choice,
    lens,
    frame,
    output_frame,
    source,
    distorted,
    mask,
    bounds,
    loss_scale,
    *,
    search: bool,
    loss: Loss,
    max_steps: int,
    solver: Static,
) -> Fit:
    dtype = common_dtype(lens, source, distorted)
    mask = jnp.ones(distorted.shape[:2], bool) if mask is None else mask
    lens, frame, output_frame, bounds = in_dtype((lens, frame, output_frame, bounds), dtype)
    model = {"lens": lens, "light": in_dtype({"gain": 1.0, "offset": 0.0}, dtype)}
    finest = _Images(
        selection=Selection(model, choice),
        frame=frame,
        output_frame=output_frame,
        source=_gray(source, dtype),
        distorted=_gray(distorted, dtype),
        weights=mask.astype(dtype).reshape(1, -1),
    )
    levels = _pyramid(lax.stop_gradient(finest))
    options = {"loss": loss, "loss_scale": loss_scale, "bounds": bounds, "max_steps": max_steps, "solver": solver.tree}
    values = lax.stop_gradient(finest.selection.values())
    if search:
        values, steps = _search(levels.pop(), values, options)
    else:
        values, steps = _judged(levels[-1], values, loss=loss)[0], jnp.zeros((), int)
    for level in reversed(levels[1:]):
        minimum = _descend(level, values, options)
        values, steps = minimum.unknowns.shared, steps + minimum.steps
    minimum = _descend(finest, values, options)
    values, steps = minimum.unknowns.shared, steps + minimum.steps
    problem = _restricted(finest, values)
    known = assess(problem, minimum, loss=loss)
    inflation = _noise_inflation(problem, minimum, known.covariance, loss)
    lens = problem.selection.insert(values)["lens"]
    _, valid = problem.places(lens)
    status = jnp.where(
        _explained(problem, known.residuals) | (known.status_code > FitStatus.DIVERGED),
        known.status_code,
        FitStatus.UNEXPLAINED,
    )
    return report(
        minimum,
        known,
        choice.names,
        lens=lens,
        frame=frame,
        covariance=known.covariance * jnp.sqrt(inflation[:, None] * inflation[None]),
        noise_inflation=inflation,
        residuals=known.residuals.reshape(*finest.distorted.shape, 1),
        status_code=status,
        steps=steps,
        folds=jnp.any(~valid),
    )


def _noise_inflation(problem: _Images, minimum: Minimum, covariance: Array, loss: Loss) -> Array:
    """Returns how many times the correlation of neighbouring residuals inflates the variance of each estimate."""
    shape, blocks = problem.distorted.shape, minimum.unknowns.blocks

    def rows(values: Array) -> Array:
        return problem.weighted(Unknowns(values, blocks))

    def influences(change: Array) -> Array:
        return jax.jvp(rows, (minimum.unknowns.shared,), (change,))[1].reshape(shape)

    moving = influence(rows(minimum.unknowns.shared), loss, minimum.loss_scale)
    return variance_inflation(influences, moving.reshape(shape), covariance)


def _explained(problem: _Images, residuals: Array) -> Array:
    """Tells whether enough of the covered pixels' variance is explained."""
    weights, observed = problem.weights[0], problem.distorted.ravel()
    total = jnp.maximum(jnp.sum(weights), 1)
    variance = jnp.sum(weights * (observed - jnp.sum(weights * observed) / total) ** 2)
    return jnp.sum(weights * residuals.ravel() ** 2) < (1 - _EXPLAINED) * variance


def _pyramid(finest: _Images) -> list[_Images]:
    """Returns the problem at several sizes, each a quarter of the one before."""
    levels = [finest]
    while min(*levels[-1].source.shape, *levels[-1].distorted.shape) >= 4 * _COARSEST:
        levels.append(_coarser(_coarser(levels[-1])))
    if len(levels) == 1 or min(*levels[-1].source.shape, *levels[-1].distorted.shape) >= 2 * _COARSEST:
        levels.append(_coarser(levels[-1]))
    return levels


def _descend(level: _Images, values: Array, options: dict) -> Minimum:
    """Fits at one level, what is covered following in rounds; differentiable in the level's pictures."""

    def one_round(state: Minimum, _: None) -> tuple[Minimum, None]:
        start = lax.stop_gradient(state.unknowns)
        found = minimize(_restricted(level, start.shared), start, **options)
        return Minimum(found.unknowns, found.loss_scale, found.status_code, state.steps + found.steps), None

    start = Minimum(Unknowns.dense(values), jnp.zeros_like(values[0]), jnp.asarray(FitStatus.MAX_STEPS), jnp.asarray(0))
    return lax.scan(one_round, start, None, length=_ROUNDS)[0]


def _restricted(level: _Images, values: Array) -> _Images:
    weights = level.weights * level.covered(Unknowns.dense(values))
    return eqx.tree_at(lambda level: level.weights, level, weights)


def _search(level: _Images, values: Array, options: dict) -> tuple[Array, Array]:
    """Finds the best lens of a grid at the coarsest level, the best few refined, and says how many steps that took."""
    starts = _grid(level, values)
    if options["bounds"] is not None:
        starts = jax.vmap(lambda start: jnp.clip(start, *options["bounds"]))(starts)
    starts, scores = lax.map(partial(_judged, level, loss=options["loss"]), starts)

    def refine(start):
        minimum = _descend(level, start, options)
        return *_judged(level, minimum.unknowns.shared, loss=options["loss"]), minimum.steps

    refined, scores, steps = lax.map(refine, starts[jnp.argsort(scores)[:_BEST]])
    return refined[jnp.argmin(scores)], jnp.sum(steps)


def _grid(level: _Images, values: Array) -> Array:
    """Starts in which the first two coefficients, or the only one, move the picture's corner by set amounts."""
    places = coefficient_places(level.selection.choice.names)[:2]
    corner = level.frame.normalize(jnp.zeros(2, values.dtype))
    moves = np.stack(np.meshgrid(*[_MOVES] * len(places), indexing="ij"), axis=-1).reshape(-1, len(places))
    starts = grid(lambda values: level.selection.insert(values)["lens"], values, places, corner, moves, observed=False)
    return jnp.concatenate([values[None], starts])


def _judged(level: _Images, values: Array, *, loss: Loss) -> tuple[Array, Array]:
    """Values with the gain and offset that suit their lens best, and what these leave of the picture's contrast."""
    names = level.selection.choice.names
    places, covered = _seen(level, values)
    total = jnp.maximum(jnp.sum(covered), 1)
    predicted, observed = interpolate(level.source, places).ravel(), level.distorted.ravel()
    x = predicted - jnp.sum(covered * predicted) / total
    y = observed - jnp.sum(covered * observed) / total
    variance = jnp.sum(covered * x * x)
    # Never a negative: that would be a match of the wrong places.
    gain = jnp.sum(covered * x * y) / jnp.where(variance > 0, variance, 1)
    gain = jnp.where(gain > 0.1, gain, 1)
    offset = jnp.sum(covered * (observed - gain * predicted)) / total
    contrast = jnp.sqrt(jnp.sum(covered * y * y) / total)
    contrast = jnp.where(contrast > 0, contrast, 1)
    # A robust loss bends where a tenth of the contrast is missed: a patch must not decide.
    left = robustify((observed - gain * predicted - offset)[:, None], loss, 0.1 * contrast)[:, 0] / contrast
    share = jnp.sum(covered * left**2) / total
    enough = total >= _COVERED * covered.size
    values = values.at[names.index("gain")].set(gain).at[names.index("offset")].set(offset)
    return values, jnp.where(enough & jnp.isfinite(share), share, jnp.inf)


def _seen(level: _Images, values: Array) -> tuple[Array, Array]:
    unknowns = Unknowns.dense(values)
    places, _ = level.places(level.selection.insert(values)["lens"])
    return places, (level.weights * level.covered(unknowns))[0]


def _coarser(level: _Images) -> _Images:
    """Returns the problem with both pictures halved; a pixel of which a part is masked is."""
    height, width = level.distorted.shape
    masked = halved(1 - level.weights.reshape(height, width, 1))
    weights = (masked == 0).astype(level.weights.dtype).reshape(1, -1)
    source, distorted = (halved(image[..., None])[..., 0] for image in (level.source, level.distorted))
    frame, output_frame = (
        Frame(0.5 * (frame.center + 0.5) - 0.5, 0.5 * frame.scale) for frame in (level.frame, level.output_frame)
    )
    return _Images(
        selection=level.selection,
        frame=frame,
        output_frame=output_frame,
        source=source,
        distorted=distorted,
        weights=weights,
    )


def _gray(image: Array, dtype) -> Array:
    image = image.astype(dtype)
    return image if image.ndim == 2 else jnp.mean(image, axis=-1)


def _check_image(name: str, image: Array) -> None:
    if image.ndim not in (2, 3) or min(image.shape) < 1 or min(image.shape[:2]) < 8:
        raise ValueError(f"{name} must have shape (H, W) or (H, W, C), 8 pixels a side at least, got {image.shape}")
    if jnp.issubdtype(image.dtype, jnp.complexfloating):
        raise ValueError(f"{name} must be real, got dtype {image.dtype}")
    if not is_concrete(image):
        return
    values = np.asarray(image)
    if not np.isfinite(values).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0][:2])
        raise ValueError(f"{name} is not finite at (row, column) {where}; fill such pixels, and give a mask")
    if values.min() == values.max():
        raise ValueError(f"{name} shows nothing: all its pixels are {values.flat[0]}")
