"""Any lens, of pictures that were turned by quarters."""

import equinox as eqx
from jaxtyping import Array, Bool, Float, PyTree

from jaxlens.lenses._lens import Lens
from jaxlens.lenses._wide_lens import WideLens
from jaxlens.maps import Inverse
from jaxlens.numerics import join


class Turned(WideLens):
    """A lens that has no parameters for it, turned: a ray is turned back, observed, and its point turned.

    Attributes:
        lens: The lens before.
        quarters: By how many quarters it is turned, counter-clockwise: 1, 2 or 3.
    """

    lens: Lens
    quarters: int = eqx.field(static=True)

    @property
    def needs_frame(self) -> bool:
        """Whether the lens itself needs a frame."""
        return self.lens.needs_frame

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, and which of the rays the lens sees."""
        points, seen = self.lens.observe(_turned(rays, -self.quarters))
        return _turned(points, self.quarters), seen

    def invert_projection(self, points: Float[Array, "*batch 2"]) -> Inverse:
        """Finds the unit rays of observed points (see `Lens.invert_projection`)."""
        found = self.lens.invert_projection(_turned(points, -self.quarters))
        return Inverse(_turned(found.points, self.quarters), found.valid, found.status)

    def field_of_view(self) -> Float[Array, ""]:
        """Returns that of the lens."""
        return self.lens.field_of_view()

    def surely_one_to_one(self, points: Float[Array, "*batch 2"]) -> Bool[Array, "*batch"] | None:
        """As of the lens."""
        return self.lens.surely_one_to_one(_turned(points, -self.quarters))

    def adjustable(self) -> PyTree:
        """Returns which numbers a fit adjusts: those of the lens."""
        return eqx.tree_at(lambda turned: turned.lens, self, self.lens.adjustable())

    def _turned_quarter(self) -> Lens:
        return self.lens if self.quarters == 3 else Turned(self.lens, self.quarters + 1)


def _turned(points: Float[Array, "*batch axes"], quarters: int) -> Float[Array, "*batch axes"]:
    """Turns points, or rays about their z."""
    x, y, *z = (points[..., axis] for axis in range(points.shape[-1]))
    for _ in range(quarters % 4):
        x, y = y, -x
    return join(x, y, *z)
