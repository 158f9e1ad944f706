"""A lens of any radial shape: a monotone spline of the observed radius over the ideal one."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._powers import smooth_root
from jaxlens.lenses._registry import register
from jaxlens.numerics import as_floating, is_concrete


@register("SplinedRadial", short="splined")
class SplinedRadial(RadialLens):
    """`r_d = S(r_u)`, a cubic spline that rises through (0, 0) and given nodes, and goes on straight beyond the last.

    Slopes at the inner nodes are those of PCHIP (Fritsch and Butland 1984): S rises wherever the values do, so the lens
    is one-to-one everywhere. At the centre and at the last node S has no curvature: the lens is smooth at its centre,
    and does not bend where the straight part begins. Its second derivatives jump at inner nodes.

    Attributes:
        nodes: Ideal radii, rising, the first above zero: the centre itself is not written. Fits leave them as they are.
        values: The observed radii there, rising, the first above zero.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl
        >>> jl.SplinedRadial([0.5, 1.0], [0.5, 0.75]).distort([1.0, 0.0]).tolist()
        [0.75, 0.0]
    """

    nodes: Float[Array, " count"]
    values: Float[Array, " count"]
    term_counts: ClassVar[tuple[int, ...]] = (6, 2, 3, 4, 5, 8, 10, 12, 16)

    def __init__(
        self,
        nodes: ArrayLike | list | tuple,
        values: ArrayLike | list | tuple,
        *,
        center: ArrayLike | list | tuple | None = None,
    ):
        self.nodes, self.values = check_nodes("SplinedRadial", nodes, values)
        self.center = as_center(center, self.values.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "SplinedRadial":
        """Returns the lens of two to sixteen nodes, six unless given, evenly spaced up to one, with them as values."""
        nodes = np.arange(1, cls.count_terms(terms) + 1) / cls.count_terms(terms)
        return cls(nodes, nodes)

    def adjustable(self) -> PyTree:
        """Returns the values alone: nodes and centre tell where the lens is, rather than what it does."""
        return eqx.tree_at(lambda lens: lens.nodes, super().adjustable(), False)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = S(r) / r."""
        return self._ratio(smooth_root(squared_radius), squared_radius)

    def radius(self, radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns the observed radius of ideal radii, S(ρ)."""
        return radius * self._ratio(radius, radius * radius)

    def fold_radius(self) -> Float[Array, ""]:
        """Returns ∞; where values do not rise, as in the course of a fit, the node after which they do not."""
        rises = jnp.diff(self.values, prepend=0) > 0
        return jnp.min(jnp.where(rises, jnp.inf, self._before()))

    def _before(self) -> Float[Array, " count"]:
        """Returns where each piece of the spline begins; it ends at the node."""
        return jnp.concatenate([jnp.zeros_like(self.nodes[:1]), self.nodes[:-1]])

    def _ratio(self, radius: Float[Array, "*batch"], squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns S(r) / r, as the sum of how much S rises on each piece.

        Nothing cancels, and nothing is looked up: a gather would be slower than all pieces of the usual few. S has no
        curvature at the centre, so that on the first piece S(r) / r is linear in r².
        """
        widths = jnp.diff(self.nodes, prepend=0)
        secants = jnp.diff(self.values, prepend=0) / widths
        slopes = _slopes(widths, secants)
        curvatures = (3 * secants - 2 * slopes[:-1] - slopes[1:]) / widths
        cubics = (slopes[:-1] + slopes[1:] - 2 * secants) / widths**2
        first, begins = self.nodes[0], self._before()
        total = first * (slopes[0] + cubics[0] * jnp.minimum(squared, first * first))
        for i in range(1, self.nodes.shape[0]):
            t = jnp.clip(radius - begins[i], 0, widths[i])
            total = total + t * (slopes[i] + t * (curvatures[i] + t * cubics[i]))
        total = total + slopes[-1] * jnp.maximum(radius - self.nodes[-1], 0)
        return total / jnp.maximum(radius, first)


def check_nodes(
    name: str, nodes: ArrayLike | list | tuple, values: ArrayLike | list | tuple
) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
    """Returns the nodes and values of a spline as arrays.

    Raises:
        ValueError: they are no lists of the same length, or known and do not rise.
    """
    x, y = as_floating(nodes), as_floating(values)
    if x.ndim != 1 or x.shape != y.shape or not x.size:
        raise ValueError(
            f"{name} takes nodes and values, two lists of the same length, got shapes {x.shape}, {y.shape}"
        )
    for which, array in (("nodes", x), ("values", y)):
        if is_concrete(array) and not np.all(np.diff(np.asarray(array), prepend=0) > 0):
            raise ValueError(f"the {which} of {name} rise from above zero, got {np.asarray(array).tolist()}")
    return x, y


def _slopes(widths: Float[Array, " count"], secants: Float[Array, " count"]) -> Float[Array, " count_and_one"]:
    """Returns the slopes of the spline at the centre and at each node.

    PCHIP's at inner nodes: a harmonic mean of the secants, weighted by widths, and zero where they do not both rise.
    At both ends the slope is the one without curvature, which lies between 0 and 3/2 of the secant.
    """
    if secants.shape[0] == 1:
        return jnp.concatenate([secants, secants])
    left, right = 2 * widths[1:] + widths[:-1], widths[1:] + 2 * widths[:-1]
    rises = jnp.minimum(secants[:-1], secants[1:]) > 0
    before, after = jnp.where(rises, secants[:-1], 1), jnp.where(rises, secants[1:], 1)
    inner = jnp.where(rises, (left + right) / (left / before + right / after), 0)
    return jnp.concatenate([(3 * secants[:1] - inner[:1]) / 2, inner, (3 * secants[-1:] - inner[-1:]) / 2])
