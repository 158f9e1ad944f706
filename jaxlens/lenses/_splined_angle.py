"""A wide lens of any radial shape: a monotone spline of the observed radius over the angle from the axis."""

from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from jaxlens.lenses._angular_lens import AngularLens
from jaxlens.lenses._registry import register
from jaxlens.lenses._splined_radial import SplinedRadial, check_nodes


@register("SplinedAngle", short="splined-angle")
class SplinedAngle(AngularLens):
    """`r_d = S(θ)`, the spline of `SplinedRadial` over the angle θ from the axis in radians, in place of a radius.

    It is one-to-one at all angles up to π; beyond the last node it goes on straight, as an equidistant lens does.

    Attributes:
        nodes: Angles, rising, the first above zero: the axis itself is not written. Fits leave them as they are.
        values: The observed radii there, rising, the first above zero.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.SplinedAngle([0.8, 1.6], [0.8, 1.4])
        >>> ray = lens.unproject(lens.project(np.array([3.0, 0.0, -1.0])))
        >>> np.round(ray * np.sqrt(10.0), 5).tolist()
        [3.0, 0.0, -1.0]
    """

    nodes: Float[Array, " count"]
    values: Float[Array, " count"]
    term_counts: ClassVar[tuple[int, ...]] = SplinedRadial.term_counts
    is_round: ClassVar[bool] = True

    def __init__(self, nodes: ArrayLike | list | tuple, values: ArrayLike | list | tuple):
        self.nodes, self.values = check_nodes("SplinedAngle", nodes, values)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "SplinedAngle":
        """Returns the equidistant lens: two to sixteen nodes, six unless given, evenly spaced up to a right angle."""
        nodes = np.pi / 2 * np.arange(1, cls.count_terms(terms) + 1) / cls.count_terms(terms)
        return cls(nodes, nodes)

    def adjustable(self) -> PyTree:
        """Returns the values alone: nodes tell where the lens is, rather than what it does."""
        return eqx.tree_at(lambda lens: lens.nodes, super().adjustable(), False)

    @property
    def plane(self) -> SplinedRadial:
        """The spline of the angle, as one of a radius."""
        return SplinedRadial(self.nodes, self.values)
