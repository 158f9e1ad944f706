"""Homographies of the plane, and the simpler maps that they are made of (section 2.2)."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from jaxlens.maps import CoordinateMap, Inverse, InverseStatus, inverse_status
from jaxlens.newton import adjugate, determinant
from jaxlens.numerics import as_floating, as_points, epsilon, is_concrete, jitted, join, split

# Rounding of a determinant, in units in the last place of the sum of its terms' sizes.
_SINGULAR_ULPS = 16.0


class Homography(CoordinateMap):
    """A projective map of the plane: `(x, y) → (X / W, Y / W)` with `(X, Y, W) = matrix · (x, y, 1)`.

    It is defined on one side of the line that it sends to infinity: **where W is positive**. The sign of the matrix
    thus chooses the side, and is the only thing about its scale that matters. With h33 = 1, as OpenCV has it, the
    origin is on that side; `−matrix` is the same map of the other side, which is seen by no camera that sees this
    one. Everywhere within its side it is one-to-one, mirrored or not.

    `a @ b` is the map that applies b first, by the product of matrices.

    Attributes:
        matrix: `(3, 3)`, regular.

    Raises:
        ValueError: a wrong shape, a matrix that is singular or not finite.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> tilted = jl.deformations.Homography([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]])
        >>> tilted(jnp.array([[2.0, 2.0], [-2.0, 0.0]])).tolist()
        [[1.0, 1.0], [nan, nan]]
    """

    matrix: Float[Array, "3 3"]

    def __init__(self, matrix: ArrayLike | list | tuple):
        self.matrix = as_floating(matrix)
        if self.matrix.shape != (3, 3):
            raise ValueError(
                f"a homography has a matrix of shape (3, 3), got {self.matrix.shape}; a batch of homographies is made "
                "by jax.vmap(Homography)(matrices)"
            )
        if is_concrete(self.matrix):
            values = np.asarray(self.matrix, np.float64)
            if not np.isfinite(values).all():
                raise ValueError(f"the matrix of a homography must be finite, got {values.tolist()}")
            if _is_singular(values, epsilon(self.matrix.dtype)):
                raise ValueError(
                    f"the matrix of a homography must be regular, got {values.tolist()}, which takes the plane to a "
                    "line or a point"
                )

    @classmethod
    def isometry(
        cls, angle: ArrayLike, translation: ArrayLike | list | tuple, *, reflect: bool = False
    ) -> "Homography":
        """Returns a rotation by `angle`, then a translation: lengths are kept.

        Args:
            angle: In radians, from the x towards the y axis.
            translation: `(2,)`, (x, y).
            reflect: Turn x into −x, before all else.
        """
        return cls.similarity(1.0, angle, translation, reflect=reflect)

    @classmethod
    def similarity(
        cls,
        scale: ArrayLike,
        angle: ArrayLike,
        translation: ArrayLike | list | tuple,
        *,
        reflect: bool = False,
    ) -> "Homography":
        """Returns an `isometry` that multiplies lengths by `scale` as well: angles are kept."""
        angle, scale = as_floating(angle), as_floating(scale)
        cosine, sine = scale * jnp.cos(angle), scale * jnp.sin(angle)
        flip = -1 if reflect else 1
        return cls.affine(jnp.stack([jnp.stack([flip * cosine, -sine]), jnp.stack([flip * sine, cosine])]), translation)

    @classmethod
    def affine(cls, matrix: ArrayLike | list | tuple, translation: ArrayLike | list | tuple) -> "Homography":
        """Returns `matrix · p + translation`: parallels are kept."""
        matrix, translation = as_floating(matrix), as_points(translation)
        if matrix.shape != (2, 2) or translation.shape != (2,):
            raise ValueError(
                f"an affine map has a (2, 2) matrix and a (2,) translation, got {matrix.shape} and {translation.shape}"
            )
        top = jnp.concatenate([matrix, translation[:, None]], axis=1)
        return cls(jnp.concatenate([top, jnp.asarray([[0, 0, 1]], top.dtype)]))

    @classmethod
    def projective(cls, line: ArrayLike | list | tuple) -> "Homography":
        """Returns the map that divides by `line · (x, y, 1)`: it sends that line to infinity.

        Args:
            line: `(3,)`, not zero in its last number: the line must not pass through the origin.
        """
        line = as_floating(line)
        if line.shape != (3,):
            raise ValueError(f"a line is given by three numbers, got shape {line.shape}")
        return cls(jnp.eye(3, dtype=line.dtype).at[2].set(line))

    @jitted
    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps points `(..., 2)`; NaN at the line that is sent to infinity, and beyond it."""
        x, y = split(as_points(points))
        image, defined = _apply(self.matrix, x, y)
        return join(*(jnp.where(defined, value, jnp.nan) for value in image))

    @jitted
    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether points lie on the side where the map is defined."""
        x, y = split(as_points(points))
        return _apply(self.matrix, x, y)[1]

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the preimages of points, in closed form.

        Args:
            points: `(..., 2)`.

        Returns:
            An `Inverse`. A point beyond the image of the line at infinity (a horizon) is seen by no point of the
            map's side: it is not valid, and has a finite stand-in that says nothing.
        """
        points = as_points(points)
        finite = jnp.all(jnp.isfinite(points), axis=-1)
        x, y = split(jnp.where(finite[..., None], points, 0))
        preimage, defined = _apply(_inverse(self.matrix), x, y)
        status = inverse_status(finite, defined, defined)
        return Inverse(join(*preimage), status == InverseStatus.CONVERGED, status)

    def inverse(self) -> "Homography":
        """Returns the inverse, a homography too: NaN where `invert` is not valid."""
        return Homography(_inverse(self.matrix))

    def adjustable(self) -> PyTree:
        """Returns all entries of the matrix but h33, which fixes its scale.

        Where h33 may come near zero, `estimate_homography` serves instead.
        """
        return eqx.tree_at(lambda homography: homography.matrix, self, np.arange(9).reshape(3, 3) < 8)

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns h11, h12, … for the matrix."""
        if field == "matrix":
            return [f"h{i + 1}{j + 1}" for i, j in np.ndindex(*shape)]
        return super().parameter_names(field, shape)

    def __matmul__(self, other: "Homography") -> "Homography":
        """Returns the map `p → self(other(p))`.

        It is that wherever both are defined; it is defined, too, where neither is.
        """
        return Homography(jnp.matmul(self.matrix, other.matrix, precision=lax.Precision.HIGHEST))

    def decompose(self) -> tuple["Homography", "Homography", "Homography"]:
        """Returns similarity, affine and projective parts: `self` is `similarity @ affine @ projective`.

        The affine part has an upper triangular matrix with a positive diagonal and determinant one, and no
        translation; the projective part divides by a line and does nothing else (`projective`); the similarity holds
        scale, rotation, translation, and the mirror, if there is one (Hartley and Zisserman, Multiple View Geometry,
        Eq. 2.17). The product has |h33| = 1.

        Raises:
            ValueError: the origin lies on the line that is sent to infinity (h33 = 0): it has no such parts.
        """
        matrix = self.matrix
        if is_concrete(matrix) and float(jnp.abs(matrix[2, 2])) <= epsilon(matrix.dtype) * float(
            jnp.max(jnp.abs(matrix[2]))
        ):
            raise ValueError(
                "the homography sends the origin to infinity (h33 = 0), and so is no product of a similarity, an "
                "affine and a projective map; move the origin of the points first"
            )
        matrix = matrix / jnp.abs(matrix[2, 2])
        line = matrix[2]
        translation = matrix[:2, 2] / line[2]
        linear = matrix[:2, :2] - translation[:, None] * line[None, :2]
        # linear = scale · Q · K by a QR decomposition: Q turns the x axis to the first column.
        length = jnp.sqrt(jnp.sum(linear[:, 0] ** 2))
        cosine, sine = linear[:, 0] / length
        mirror = jnp.sign(linear[0, 0] * linear[1, 1] - linear[0, 1] * linear[1, 0])
        turn = jnp.stack([jnp.stack([cosine, -mirror * sine]), jnp.stack([sine, mirror * cosine])])
        upper = jnp.sum(turn[:, :, None] * linear[:, None, :], axis=0)
        scale = jnp.sqrt(length * upper[1, 1])
        zero = jnp.zeros_like(scale)
        shape = jnp.stack([jnp.stack([length, upper[0, 1]]), jnp.stack([zero, upper[1, 1]])]) / scale
        return (
            Homography.affine(scale * turn, translation),
            Homography.affine(shape, jnp.zeros_like(translation)),
            Homography.projective(line),
        )


def denominators(matrix: Float[Array, "3 3"], points: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Returns W of points: positive where a homography is defined."""
    x, y = split(points)
    return matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]


def _apply(matrix: Array, x: Array, y: Array) -> tuple[tuple[Array, Array], Array]:
    """Returns the image of points, and where it is defined; finite elsewhere, and in its derivatives."""
    finite = jnp.isfinite(x) & jnp.isfinite(y)
    x, y = jnp.where(finite, x, 0), jnp.where(finite, y, 0)
    down = denominators(matrix, join(x, y))
    defined = finite & (down > 0)
    right, up = (row[0] * x + row[1] * y + row[2] for row in matrix[:2])
    inverse = 1 / jnp.where(defined, down, 1)
    # Next to the line at infinity the quotient overflows: nowhere is where it is.
    largest = jnp.finfo(inverse.dtype).max
    defined &= (jnp.abs(right) * inverse <= largest) & (jnp.abs(up) * inverse <= largest)
    inverse = jnp.where(defined, inverse, 0)
    return (right * inverse, up * inverse), defined


def _inverse(matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Inverts by the adjugate: its sign is such that it is defined exactly where the map's image is."""
    return adjugate(matrix) / determinant(matrix)


def _is_singular(matrix: Float[np.ndarray, "3 3"], eps: float) -> bool:
    """Tells whether a determinant is nothing but rounding, whatever the units of rows and columns."""
    a, b, c = matrix.T
    positive = np.abs(np.roll(b, -1) * np.roll(c, -2)) + np.abs(np.roll(b, -2) * np.roll(c, -1))
    return bool(abs(a @ np.cross(b, c)) <= _SINGULAR_ULPS * eps * np.sum(np.abs(a) * positive))
