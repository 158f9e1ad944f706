"""Homographies, and the simpler maps of the plane, from correspondences: least squares in the target."""

from functools import partial
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Int8

from jaxlens.deformations._arguments import as_correspondences, check_digits
from jaxlens.deformations._configurations import check_configuration
from jaxlens.deformations._dlt import conditioned, direct_linear_transform, unconditioned
from jaxlens.deformations._homography import Homography, denominators
from jaxlens.linear import invert_definite, squares_rounding
from jaxlens.numerics import Status, as_points, epsilon, is_concrete, join, split

Kind = Literal["projective", "affine", "similarity", "isometry"]
"""Which maps are looked for: of 8, 6, 4 and 3 parameters. A similarity and an isometry do not mirror."""

_MAXIMUM_STEPS = 100
_HIGHEST = lax.Precision.HIGHEST


class EstimateStatus(Status):
    """How an estimate ended."""

    CONVERGED = 0
    """At the minimum, to the precision of the dtype."""
    NOT_CONVERGED = 1
    """Out of steps; the homography is the best found so far."""
    DEGENERATE = 2
    """No homography, or none in particular, takes the one points to the others: the result is worth nothing."""


class HomographyEstimate(eqx.Module):
    """What `estimate_homography` found.

    Attributes:
        homography: The map from source to target. Its matrix is scaled so that the denominator is 1 at the (weighted)
            centroid of the source points, where it can never vanish; `matrix / matrix[2, 2]` is OpenCV's.
        covariance: `(9, 9)`, of the entries of that matrix, row by row; of rank 8, 6, 4 or 3, as many as there are
            parameters. With the variance of the residuals, NaN where no residuals are left to tell it.
        residuals: `(N, 2)`, target − predicted, not weighted; zero where the weight is zero.
        rms: The root of the (weighted) mean squared length of the residuals.
        degrees_of_freedom: Residual components less parameters.
        status: An `EstimateStatus`.
    """

    homography: Homography
    covariance: Float[Array, "9 9"]
    residuals: Float[Array, "points 2"]
    rms: Float[Array, ""]
    degrees_of_freedom: Int[Array, ""]
    status: Int8[Array, ""]

    @property
    def standard_errors(self) -> Float[Array, "*batch 3 3"]:
        """The square roots of the variances of the matrix's entries."""
        variances = jnp.diagonal(self.covariance, axis1=-2, axis2=-1)
        return jnp.sqrt(jnp.maximum(variances, 0)).reshape(*variances.shape[:-1], 3, 3)

    def point_covariance(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2 2"]:
        """Returns the covariance of where `homography` takes exact points (Hartley and Zisserman, section 5.2.6)."""
        points = as_points(points)

        def image(entries):
            return Homography(entries.reshape(3, 3))(points)

        derivative = jax.jacfwd(image)(self.homography.matrix.ravel())
        return jnp.einsum("...ai,ij,...bj->...ab", derivative, self.covariance, derivative, precision=_HIGHEST)


def estimate_homography(
    source: Float[ArrayLike, "points 2"],
    target: Float[ArrayLike, "points 2"],
    *,
    weights: Float[ArrayLike, " points"] | None = None,
    kind: Kind = "projective",
    throw: bool = True,
) -> HomographyEstimate:
    """Finds the homography that takes source to target points, by least squares of the distances in the target.

    A homography starts from the normalized direct linear transform and is refined by Levenberg–Marquardt; affine
    maps, similarities and isometries are found in closed form. All in normalized coordinates, and in double precision
    where x64 is enabled.

    Args:
        source: `(N, 2)` points, (x, y) order; at least 4 (affine: 3, similarity and isometry: 2).
        target: `(N, 2)`, where they are seen. Noise is here; it should be the same for all, but for the weights.
        weights: `(N,)`, inverse variances up to a common factor. Points of weight zero do not count, and may be NaN.
        kind: Which maps are looked for, see `Kind`.
        throw: Raise `RuntimeError` unless the minimum was reached. Under `jax.jit` and `jax.vmap` nothing is raised:
            look at `status`.

    Returns:
        A `HomographyEstimate`, in the widest dtype of the data. Differentiable with respect to points and weights, by
        the implicit function theorem for a homography; an exact fit is nothing special.

    Raises:
        ValueError: shapes that do not fit, points that are not finite, too few of them, or a degenerate configuration:
            points that coincide, or all or all but one of which lie on one line; correspondences that no homography
            explains without sending some of the source points beyond infinity (corners in the wrong order);
            coordinates so large beside their extent that the dtype rounds them away (map coordinates in float32).
        RuntimeError: `throw`, and the iteration did not converge.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> corners = jnp.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        >>> seen = jnp.array([[10.0, 10.0], [30.0, 12.0], [28.0, 25.0], [11.0, 30.0]])
        >>> estimate = jl.deformations.estimate_homography(corners, seen)
        >>> bool(jnp.max(jnp.abs(estimate.homography(corners) - seen)) < 1e-3)
        True
    """
    if kind not in get_args(Kind):
        raise ValueError(f"kind must be one of {', '.join(get_args(Kind))}, got {kind!r}")
    source, target, weights = as_correspondences(source, target, weights)
    if is_concrete(source, target, weights):
        check_configuration(source, target, weights, kind)
        check_digits(source, weights, "source")
        check_digits(target, weights, "target")
    estimate = _estimate(source, target, weights, kind=kind)
    if not is_concrete(estimate):
        return estimate
    if int(estimate.status) == EstimateStatus.DEGENERATE:
        raise ValueError(
            f"no {kind} map in particular takes these source points to these targets, or only one that sends some of "
            "them beyond the line at infinity: are the correspondences in the right order, and not nearly on a line?"
        )
    if throw and int(estimate.status) == EstimateStatus.NOT_CONVERGED:
        raise RuntimeError(
            f"the homography was not found within {_MAXIMUM_STEPS} steps: are the correspondences in the right order?"
        )
    return estimate


class _Data(eqx.Module):
    """Conditioned correspondences; weights that sum to one, and the factor that an isometry has between the two."""

    source: Float[Array, "points 2"]
    target: Float[Array, "points 2"]
    weights: Float[Array, " points"]
    ratio: Float[Array, ""]


@partial(jax.jit, static_argnames="kind")
def _estimate(source: Array, target: Array, weights: Array, *, kind: Kind) -> HomographyEstimate:
    result_dtype = jnp.result_type(source, target, weights)
    dtype = jnp.result_type(result_dtype, float)  # in double precision wherever there is one
    used = weights > 0
    weights = jnp.where(used, weights, 0).astype(dtype) / jnp.sum(weights).astype(dtype)
    source, target = (jnp.where(used[:, None], points, 0).astype(dtype) for points in (source, target))
    near, from_source = conditioned(source, weights)
    far, from_target = conditioned(target, weights)
    data = _Data(near, far, weights, from_target[0, 0] / from_source[0, 0])
    values, converged = _projective(data) if kind == "projective" else (_closed_form(data, kind), jnp.asarray(True))

    def whole(values):
        return unconditioned(_matrix(values, data.ratio, kind), from_source, from_target)

    matrix = whole(values)
    rows = _residuals(values, data, kind).ravel()
    derivative = jax.jacfwd(lambda values: _residuals(values, data, kind).ravel())(values)
    freedom = 2 * jnp.sum(used) - values.shape[0]
    normal = jnp.matmul(derivative.T, derivative, precision=_HIGHEST)
    inverse, _, regular = invert_definite(normal, rounding=squares_rounding(dtype))
    variance = jnp.sum(rows**2) / jnp.where(freedom > 0, freedom, jnp.nan)  # an exact fit says nothing about the noise
    entries = jax.jacfwd(lambda values: whole(values).ravel())(values)
    covariance = variance * jnp.einsum("ia,ab,jb->ij", entries, inverse, entries, precision=_HIGHEST)

    down = denominators(matrix, source)
    in_front = jnp.all(~used | (down > 0))
    residuals = jnp.where(used[:, None], target - _divide(matrix, source, down), 0)
    status = jnp.where(converged, EstimateStatus.CONVERGED, EstimateStatus.NOT_CONVERGED)
    status = jnp.where(regular & in_front, status, EstimateStatus.DEGENERATE).astype(jnp.int8)
    rms = jnp.sqrt(jnp.sum(weights[:, None] * residuals**2))
    matrix, covariance, residuals, rms = (value.astype(result_dtype) for value in (matrix, covariance, residuals, rms))
    return HomographyEstimate(Homography(matrix), covariance, residuals, rms, freedom, status)


def _projective(data: _Data) -> tuple[Float[Array, "8"], Bool[Array, ""]]:
    fixed = lax.stop_gradient(data)
    start = direct_linear_transform(fixed.source, fixed.target, fixed.weights)
    # The denominator in the middle of the points is the mean of theirs: positive where all of theirs are.
    start = (start / jnp.where(start[2, 2] > 0, start[2, 2], 1)).ravel()[:8]
    in_front = jnp.all((denominators(_matrix(start, data.ratio, "projective"), fixed.source) > 0) | (data.weights == 0))
    eps = epsilon(start.dtype)
    solver = optx.LevenbergMarquardt(rtol=eps**0.6, atol=8 * eps)
    solution = optx.least_squares(
        _projective_residuals, solver, jnp.where(in_front, start, 0), data, max_steps=_MAXIMUM_STEPS, throw=False
    )
    # A start that is no homography in front of the points is none to be refined, but to be refused.
    return jnp.where(in_front, solution.value, jnp.nan), solution.result == optx.RESULTS.successful


def _projective_residuals(values: Array, data: _Data) -> Array:
    return _residuals(values, data, "projective")


def _closed_form(data: _Data, kind: Kind) -> Float[Array, " parameters"]:
    """Fits in closed form, about the centroids: the best maps of these kinds take one to the other."""
    weighted = data.weights[:, None] * data.source
    zero = jnp.zeros_like(data.ratio)
    cross = jnp.matmul(data.target.T, weighted, precision=_HIGHEST)
    square = jnp.matmul(data.source.T, weighted, precision=_HIGHEST)
    if kind == "affine":
        (a, b), (_, d) = square
        inverse = jnp.stack([jnp.stack([d, -b]), jnp.stack([-b, a])]) / (a * d - b * b)
        linear = jnp.matmul(cross, inverse, precision=_HIGHEST)
        return jnp.stack([linear[0, 0], linear[0, 1], zero, linear[1, 0], linear[1, 1], zero])
    along, across = cross[0, 0] + cross[1, 1], cross[1, 0] - cross[0, 1]
    if kind == "similarity":
        total = square[0, 0] + square[1, 1]
        return jnp.stack([along / total, across / total, zero, zero])
    return jnp.stack([jnp.arctan2(across, along), zero, zero])


def _matrix(values: Float[Array, " parameters"], ratio: Float[Array, ""], kind: Kind) -> Float[Array, "3 3"]:
    """Returns the matrix of conditioned coordinates."""
    zero, one = jnp.zeros_like(ratio), jnp.ones_like(ratio)
    match kind:
        case "projective":
            entries = [*values, one]
        case "affine":
            entries = [*values, zero, zero, one]
        case "similarity":
            a, b, x, y = values
            entries = [a, -b, x, b, a, y, zero, zero, one]
        case "isometry":
            angle, x, y = values
            a, b = ratio * jnp.cos(angle), ratio * jnp.sin(angle)
            entries = [a, -b, x, b, a, y, zero, zero, one]
    return jnp.stack(entries).reshape(3, 3)


def _residuals(values: Array, data: _Data, kind: Kind) -> Float[Array, "points 2"]:
    matrix = _matrix(values, data.ratio, kind)
    used = data.weights > 0
    scale = jnp.where(used, jnp.sqrt(jnp.where(used, data.weights, 1)), 0)
    predicted = _divide(matrix, data.source, denominators(matrix, data.source))
    return scale[:, None] * (data.target - predicted)


def _divide(matrix: Array, points: Array, down: Array) -> Array:
    """Returns the image of points, beyond the line at infinity too; finite on it."""
    x, y = split(points)
    down = jnp.where(down == 0, 1, down)
    return join(*((row[0] * x + row[1] * y + row[2]) / down for row in matrix[:2]))
