"""A rotating camera with a lens: the focal length that it finds for itself, before and after the lens is taken out."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxlens.deformations import direct_linear_transform
from jaxlens.experiments.schema import RotationExperiment
from jaxlens.fitting import fit_points, rotation_matrix
from jaxlens.lenses import RadialPolynomial
from jaxlens.self_calibration import RotatingCamera, self_calibrate_focal_length


@dataclass(frozen=True, eq=False)
class Biases:
    """Relative errors of self-calibrated focal lengths, estimate / truth − 1, one entry a lens.

    Attributes:
        name: Of the set of rotations.
        raw: With the lens in place; infinite where no focal length fits.
        known: After undistorting with the lens itself.
        fitted: `(lenses, seeds)`, after undistorting with lenses fitted to noisy points.
    """

    name: str
    raw: Float[np.ndarray, " lenses"]
    known: Float[np.ndarray, " lenses"]
    fitted: Float[np.ndarray, "lenses seeds"]

    @property
    def fitted_rms(self) -> Float[np.ndarray, " lenses"]:
        """The root of the mean square over the seeds."""
        return np.sqrt(np.mean(self.fitted**2, axis=1))


def rotations_of(turns: Sequence[Sequence[float | int]], dtype: str) -> Float[Array, "views 3 3"]:
    """Returns the matrices of rotation vectors [pan, tilt, roll] in degrees."""
    pan, tilt, roll = np.radians(np.asarray(turns, np.float64)).T
    return rotation_matrix(jnp.asarray(np.stack([tilt, pan, roll], axis=1), dtype))


def focal_length_biases(experiment: RotationExperiment) -> list[Biases]:
    """Measures the bias of every lens of the experiment, for each set of rotations.

    The homographies of all sets come from one program, whose compilation is most of the work.
    """
    dtype, sets = experiment.dtype, [one.turns for one in experiment.rotations]
    keys = jax.random.split(jax.random.key(experiment.seed), (len(experiment.k), experiment.seeds))
    found = _homographies(
        jnp.asarray(experiment.k, dtype),
        keys,
        rotations_of(list(itertools.chain(*sets)), dtype),
        jnp.asarray(experiment.focal_length, dtype),
        jnp.asarray(experiment.noise, dtype),
        aspect=experiment.aspect,
        points=experiment.points,
    )
    biases, first = [], 0
    for rotations in experiment.rotations:
        last = first + len(rotations.turns)
        lengths = np.asarray(_focal_lengths(found[:, :, first:last]), np.float64) / experiment.focal_length
        biases.append(Biases(rotations.name, lengths[:, 0] - 1, lengths[:, 1] - 1, lengths[:, 2:] - 1))
        first = last
    return biases


@jax.jit
@partial(jax.vmap, in_axes=0)
@partial(jax.vmap, in_axes=0)
def _focal_lengths(homographies: Float[Array, "views 3 3"]) -> Float[Array, ""]:
    return self_calibrate_focal_length(homographies).focal_length


@partial(jax.jit, static_argnames=("aspect", "points"))
def _homographies(
    k: Float[Array, " lenses"],
    keys: Array,
    rotations: Float[Array, "views 3 3"],
    focal_length: Float[Array, ""],
    noise: Float[Array, ""],
    *,
    aspect: float,
    points: int,
) -> Float[Array, "lenses cases views 3 3"]:
    """Homographies with the lens in place, with the lens itself taken out, and with each of the fitted ones."""

    def of_lens(k: Array, keys: Array) -> Array:
        camera = RotatingCamera(RadialPolynomial(k[None]), focal_length, aspect=aspect)
        before, after, seen = jax.vmap(camera.correspondences)(rotations)
        fitted = jax.vmap(lambda key: _fitted(camera, key, points, noise))(keys)
        # No lens at all is one, too.
        kappa = jnp.concatenate([jnp.stack([0 * k, k]), fitted])

        def undistorted(kappa: Array) -> Array:
            lens = RadialPolynomial(kappa[None])
            source, target = lens.invert(before).points, lens.invert(after).points
            return jax.vmap(direct_linear_transform)(source, target, seen.astype(before.dtype))

        return lax.map(undistorted, kappa)

    return lax.map(lambda one: of_lens(*one), (k, keys))


def _fitted(camera: RotatingCamera, key: Array, points: int, noise: Array) -> Float[Array, ""]:
    """The coefficient as a calibration finds it from points with noise, spread evenly over the picture."""
    places, errors = jax.random.split(key)
    dtype = camera.half_field.dtype
    observed = camera.half_field[None] * jax.random.uniform(places, (points, 2), dtype, -1, 1)
    ideal = camera.lens.invert(observed).points
    seen = observed + noise * jax.random.normal(errors, observed.shape, dtype)
    lens = fit_points(RadialPolynomial(jnp.zeros(1, dtype)), ideal, seen).lens
    assert isinstance(lens, RadialPolynomial)
    return lens.coefficients[0]
