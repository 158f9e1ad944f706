"""The distortion curve of a fit: how far a lens moves points, and how well that is known."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxlens.fitting._parameters import Choice, Selection, choose
from jaxlens.fitting._result import Fit


def distortion_curve(
    fit: Fit, radii: Float[ArrayLike, " radii"], *, angle: float = 0.0
) -> tuple[Float[Array, " radii"], Float[Array, " radii"]]:
    """Returns how far the lens moves points outwards, and the standard error of that, by the delta method.

    Args:
        fit: A fit; of one whose covariance is unknown the errors are NaN.
        radii: Ideal radii from the frame's origin, normalized.
        angle: The direction of the ray, in radians from x towards y; it matters to lenses that are not radial.

    Returns:
        Observed less ideal radius along the ray, and its standard error, both normalized.
    """
    direction = jnp.asarray([np.cos(angle), np.sin(angle)], fit.values.dtype)
    radii = jnp.asarray(radii, fit.values.dtype)
    selection, places = _lens_parameters(fit)

    def moved(values):
        lens = selection.insert(values)
        return (lens.distort(radii[:, None] * direction[None]) - radii[:, None] * direction[None]) @ direction

    values = selection.values()
    slope = jax.jacfwd(moved)(values)
    covariance = fit.covariance[np.ix_(places, places)]
    variance = jnp.einsum("ri,ij,rj->r", slope, covariance, slope)
    return moved(values), jnp.sqrt(jnp.maximum(variance, 0))


def _lens_parameters(fit: Fit) -> tuple[Selection, list[int]]:
    """Returns the fitted numbers of the lens, and where they stand among all that was fitted."""
    every = choose(fit.lens, jax.tree.map(lambda _: True, fit.lens))
    kept = [(index, name) for index, name in zip(*every, strict=True) if name in fit.names]
    choice = Choice(tuple(index for index, _ in kept), tuple(name for _, name in kept))
    return Selection(fit.lens, choice), [fit.names.index(name) for name in choice.names]
