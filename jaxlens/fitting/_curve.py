"""The distortion curve of a fit: how far a lens moves points, and how well that is known."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxlens.fitting._parameters import named
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
    selection, places = named(fit.lens, fit.names)

    def moved(values):
        lens = selection.insert(values)
        return (lens.distort(radii[:, None] * direction[None]) - radii[:, None] * direction[None]) @ direction

    values = selection.values()
    slope = jax.jacfwd(moved)(values)
    covariance = fit.covariance[np.ix_(places, places)]
    variance = jnp.einsum("ri,ij,rj->r", slope, covariance, slope)
    return moved(values), jnp.sqrt(jnp.maximum(variance, 0))
