"""From one family of lenses to another: the nearest camera of a family, by least squares on rays."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxlens.cameras import Camera
from jaxlens.fitting._parameters import Choice, Selection, choose, free_mask, in_dtype
from jaxlens.fitting._problem import Problem, assess, minimize, report
from jaxlens.fitting._result import Fit, FitStatus, checked
from jaxlens.fitting._solver import Unknowns
from jaxlens.fitting._uncertainty import frame_of, is_wide, model_of, seen_at
from jaxlens.frames import Frame
from jaxlens.lenses import Lens
from jaxlens.numerics import is_concrete, join, split

# Places to each side of the picture at which the two are compared.
_PLACES = 33
# How far from the axis the scales of two lenses are compared.
_NEAR_AXIS = 1e-2


class Conversion(eqx.Module):
    """A camera in another family of lenses, and how far it is from the one that it stands for.

    Attributes:
        camera: The camera of the other family.
        fit: How it was found; its residuals `(N, 2)`, in pixels, are the first camera's pixel less the new one's.
        largest: The largest distance between the two, in pixels.
        where: (x, y) of the pixel where that is.
    """

    camera: Camera
    fit: Fit
    largest: Float[Array, ""]
    where: Float[Array, "2"]

    @property
    def rms(self) -> Float[Array, ""]:
        """The root of the mean squared distance between the two over the picture, in pixels."""
        return self.fit.rms


class _Rays(Problem):
    selection: Selection
    rays: Float[Array, "points 3"]
    observed: Float[Array, "points 2"]
    weights: Float[Array, "1 points"]

    def residuals(self, unknowns: Unknowns) -> Float[Array, "1 points 2"]:
        model = self.selection.insert(unknowns.shared)
        return (self.observed - seen_at(model["lens"], frame_of(model), self.rays))[None]


def convert(camera: Camera, family: type[Lens] | Lens, *, terms: int | None = None, throw: bool = True) -> Conversion:
    """Finds the camera of another family of lenses that is nearest to a camera, over its whole picture.

    Least squares on the rays of a grid of pixels: coefficients, focal lengths and principal point are fitted. Where the
    other family contains the camera's, that is exact to rounding.

    Args:
        camera: What is to be converted. Pixels without a ray do not count.
        family: The class of lenses, or a lens of it from which to start.
        terms: How many coefficients, of a class with `term_counts`.
        throw: Raise `FitError` unless the fit has converged.

    Returns:
        A `Conversion`: the camera, its RMS and largest difference in pixels, and where that is. In the dtype of the
        camera; differentiable by its parameters.

    Raises:
        ValueError: the camera sees past 90° from its axis, and the family, on the plane, does not; no pixel has a ray.
        FitError: `throw`, and no result worth having.

    Example:
        >>> import jaxlens as jl
        >>> camera = jl.Camera(jl.RadialPolynomial([-0.1, 0.01]), jl.Frame([319.5, 239.5], 500.0), 640, 480)
        >>> found = jl.fitting.convert(camera, jl.BrownConrady)
        >>> bool(found.largest < 0.01)
        True
    """
    start = family.identity(terms=terms) if isinstance(family, type) else family
    x, y = jnp.meshgrid(*(jnp.linspace(-0.5, size - 0.5, _PLACES) for size in (camera.width, camera.height)))
    pixels = join(x.ravel(), y.ravel()).astype(camera.frame.scale.dtype)
    rays = camera.unproject(pixels)
    seen = jnp.isfinite(rays).all(-1)
    _check(camera, start, rays, seen)
    model = model_of(camera.frame, start)
    choice = choose(
        model, {"camera": {"focal_length": True, "principal_point": True}, "lens": free_mask(start, None, center=False)}
    )
    fit, folded = _fit(choice, camera, model, pixels, rays, seen)
    # Families with more numbers than a lens needs leave some undetermined, and the camera is the nearest all the same.
    if is_concrete(fit.status_code) and fit.status not in (FitStatus.CONVERGED, FitStatus.RANK_DEFICIENT):
        checked(fit, throw)
    distances = jnp.hypot(*split(fit.residuals))
    farthest = jnp.argmax(jnp.where(folded, jnp.inf, distances))
    assert isinstance(fit.lens, Lens)
    assert fit.frame is not None
    return Conversion(
        Camera(fit.lens, fit.frame, camera.width, camera.height),
        fit,
        jnp.where(jnp.any(folded), jnp.inf, distances[farthest]),
        pixels[farthest],
    )


def _check(camera: Camera, start: Lens, rays: Array, seen: Array) -> None:
    if not is_concrete(rays):
        return
    if not np.any(seen):
        raise ValueError("the camera sees nothing: none of its pixels has a ray")
    behind = np.mean(np.asarray(rays)[np.asarray(seen), 2] <= 0)
    if behind > 0 and not is_wide(start):
        raise ValueError(
            f"{100 * behind:.0f} % of the picture lie 90° or more from the axis, where {type(start).__name__}, a lens "
            "on the plane, sees nothing: take a family of wide lenses, as KannalaBrandt, or convert camera.cropped(...)"
        )


def _stretch(lens: Lens, beside: Float[Array, "3"]) -> Float[Array, "2"]:
    """Returns how far a ray beside the axis is seen from the axis."""
    return jnp.abs(lens.project(beside) - lens.project(beside.at[:2].set(0)))


@partial(jax.jit, static_argnames=("choice",))
def _fit(choice: Choice, camera: Camera, model, pixels, rays, seen) -> tuple[Fit, Bool[Array, " points"]]:
    dtype = jnp.result_type(rays.dtype, pixels.dtype)
    model, pixels, rays = in_dtype((model, pixels, rays), dtype)
    rays = jnp.where(seen[:, None], rays, jnp.asarray([0, 0, 1], dtype)[None])
    # Families differ in their scale on the axis: a unified lens's, for one, is half a perspective one's.
    beside = jnp.asarray([_NEAR_AXIS, _NEAR_AXIS, 1], dtype)
    own, other = (_stretch(lens, beside) for lens in (camera.lens, model["lens"]))
    frame = frame_of(model)
    model = model_of(Frame(frame.center, frame.scale * own / other), model["lens"])
    selection = Selection(model, choice)
    observed, weights = jnp.where(seen[:, None], pixels, 0), seen.astype(dtype)[None]
    problem = _Rays(selection=selection, rays=rays, observed=observed, weights=weights)
    minimum = minimize(problem, Unknowns.dense(selection.values()))
    known = assess(problem, minimum)
    found = selection.insert(minimum.unknowns.shared)
    folded = ~jnp.isfinite(split(found["lens"].project(rays))[0]) & seen
    fit = report(
        minimum,
        known,
        choice.names,
        lens=found["lens"],
        frame=frame_of(found),
        residuals=jnp.where(seen[:, None], known.residuals[0], 0),
        folds=jnp.any(folded),
    )
    return fit, folded
