"""What a face is made of: domes, bumps and creases in closed form, all smooth, and their colours.

Lengths are in head heights, as in `FaceShape`. The literal numbers are the places and sizes of details, chosen by eye
on shaded pictures; what one would want to change is a measure of the shape.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, Float

if TYPE_CHECKING:
    from jaxlens.surfaces._face import FaceShape


Number = Array | float
Hill = tuple[Number, Number, Number, Number, Number, Number]
"""Height, x and y of the top, standard deviations along both axes, and by which angle these are turned."""


def outlines(shape: "FaceShape", x: Array, y: Array) -> tuple[Array, Array]:
    """Returns how far inside cranium and jaw points lie: one in the middle, zero at the outline."""
    cranium = 1 - (x / (0.5 * shape.head_width)) ** 2 - ((y + 0.13) / 0.37) ** 2
    half = 0.5 * shape.jaw_width * (1.05 - 0.17 * jnp.tanh((y - 0.20) / 0.16))
    q = ((y - 0.06) / 0.44) ** 2
    jaw = 1 - (x / half) ** 2 - q**2 * (0.30 + 0.70 * q)
    return cranium, jaw


def skull(shape: "FaceShape", x: Array, y: Array) -> Float[Array, "*batch"]:
    """Returns the height of the head without features."""
    cranium, jaw = (shape.head_depth * _soft_root(inside, 0.004) for inside in outlines(shape, x, y))
    return _soft_maximum(cranium, 0.97 * jaw, 0.014)


def relief(shape: "FaceShape", x: Array, y: Array) -> Float[Array, "*batch"]:
    """Returns the height of the face; near the nose tip `FaceShape.depth_at` trims it."""
    z = skull(shape, x, y) + _folds(shape, x, y)
    z = _with_eyes(shape, z, x, y)
    return z + _nose(shape, x, y) + _lips(shape, x, y)


def albedo(shape: "FaceShape", x: Array, y: Array) -> Float[Array, "*batch"]:
    """Returns the share of light that the face reflects."""
    picture = 0.82 - _hills(x, y, _both_sides((0.05, 0.17, 0.13, 0.06, 0.05, 0.0)))
    side = jnp.sqrt(x * x + 1e-6)
    hairline = -0.345 + 0.30 * _step(side - 0.29, 0.028)
    picture = _painted(picture, 0.22, _step(hairline - y, 0.008))
    u = (side - 0.13) / 0.075
    brow = _bell(y + 0.098 + 0.010 * (1 - (u - 0.3) ** 2) - 0.006 * u, 0.0095 - 0.0035 * u) * _step(1 - u * u, 0.13)
    picture = _painted(picture, 0.25, 0.9 * brow)
    line, upper, lower, u = _lip_lines(shape, x)
    between = _step(1 - u * u, 0.05)
    lips = _step(y - (2 * upper - line) - 0.002, 0.003) * _step(2 * lower - line - 0.002 - y, 0.003) * between
    picture = _painted(picture, 0.52, lips)
    picture = _painted(picture, 0.25, _bell(y - line, 0.0035) * between)
    x_eyes, y_eyes = jnp.stack([x, -x]), jnp.stack([y, y])
    opening = _eye_opening(shape, x_eyes, y_eyes)
    opened = _step(opening, 0.0022)
    dx = x_eyes - 0.5 * shape.eye_distance
    radius = jnp.sqrt(dx**2 + (y_eyes + 0.002) ** 2 + 1e-6)
    lashes = _bell(opening, 0.003) * _step(0.006 - y_eyes, 0.004) * _step(1 - (dx / 0.066) ** 2, 0.1)
    iris, pupil = opened * _step(0.024 - radius, 0.0015), opened * _step(0.010 - radius, 0.0012)
    for value, cover in ((0.92, opened), (0.30, iris), (0.06, pupil), (0.2, lashes)):
        picture = _painted(picture, value, jnp.sum(cover, axis=0))
    return _painted(picture, 0.2, 0.8 * _hills(x, y, _nostrils(shape)))


def _folds(shape: "FaceShape", x: Array, y: Array) -> Array:
    """Sums all hills and hollows: forehead, brows, sockets, temples, cheeks, the folds to the mouth, teeth, chin."""
    eye, mouth, corner = 0.5 * shape.eye_distance, shape.mouth_y, 0.5 * shape.mouth_width
    sides = (
        (shape.brow, 0.095, -0.080, 0.065, 0.024, -0.12),
        (-shape.socket, eye - 0.006, 0.004, 0.062, 0.044, 0.0),
        (-0.008, 0.29, -0.05, 0.05, 0.08, 0.0),
        (shape.cheek, 0.165, 0.110, 0.06, 0.05, 0.5),
        (-0.008, 0.19, 0.27, 0.05, 0.08, 0.0),
        (-0.006, corner + 0.012, mouth - 0.065, 0.014, 0.05, -0.39),
        (-0.006, corner + 0.004, mouth + 0.004, 0.012, 0.010, 0.0),
    )
    middle = (
        (0.010, 0.0, -0.25, 0.16, 0.09, 0.0),
        (0.020, 0.0, mouth - 0.005, 0.085, 0.06, 0.0),
        (-0.005, 0.0, mouth - 0.062, 0.010, 0.022, 0.0),
        (shape.chin, 0.0, mouth + 0.14, 0.06, 0.045, 0.0),
        (-0.016, 0.0, mouth + 0.075, 0.06, 0.016, 0.0),
        (0.006, 0.0, shape.nose_y + 0.030, 0.009, 0.012, 0.0),
    )
    nostrils = [(-0.030, *hill[1:]) for hill in _nostrils(shape)]
    return _hills(x, y, [*_both_sides(*sides), *middle, *nostrils])


def _with_eyes(shape: "FaceShape", z: Array, x: Array, y: Array) -> Array:
    """Eyeballs in their sockets, with lids that leave an almond open, and the crease above them."""
    eye, radius = 0.5 * shape.eye_distance, shape.eye_radius
    bottom = skull(shape, eye, jnp.zeros_like(eye)) - shape.socket
    x, y = jnp.stack([x, -x]), jnp.stack([y, y])
    dx = x - eye
    squared = dx**2 + y**2
    ball = bottom + 0.018 - radius + _soft_root(radius**2 - squared, 0.05 * radius**2)
    ball = ball - 0.3 * _step(squared - radius**2, 2e-4)
    lids = 0.008 * jnp.exp(-((squared / 0.075**2) ** 2)) * _step(-_eye_opening(shape, x, y), 0.0022)
    u = dx / 0.07
    crease = 0.006 * _bell(y + 0.043 - 0.022 * u * u, 0.005) * jnp.exp(-(u**4))
    for one in (0, 1):
        z = _soft_maximum(z, ball[one], 0.010)
    return z + jnp.sum(lids - crease, axis=0)


def _eye_opening(shape: "FaceShape", x: Array, y: Array) -> Array:
    """Returns how far inside the opening of the lids, for x > 0, a point lies."""
    u = (x - 0.5 * shape.eye_distance) / 0.064
    slanted = y + 0.010 * u
    return -_soft_maximum(-0.028 * (1 - u * u) - slanted, slanted - 0.020 * (1 - u * u), 0.002)


def _nose(shape: "FaceShape", x: Array, y: Array) -> Array:
    """Joins bridge, tip and wings as probabilities are: a + b − ab never exceeds its bound."""
    tip, high, wing = shape.nose_y, shape.nose_height, 0.5 * shape.nose_width
    t = (y + 0.03) / (tip + 0.03)  # zero at the root, one at the tip
    half = 0.024 + 0.014 * _step(t - 0.62, 0.12) - 0.003 * _bell(t - 0.05, 0.2)
    along = (0.10 + 0.74 * t + 0.04 * _bell(t - 0.45, 0.15)) * _step(t + 0.22, 0.10) * _step(tip + 0.021 - y, 0.0075)
    bridge = along * _lobe((x / (1.45 * half)) ** 2, 0.6)
    ball = 0.97 * _lobe((x / 0.036) ** 2 + ((y - tip - 0.001) / 0.030) ** 2, 0.6)
    x, y = jnp.stack([x, -x]), jnp.stack([y, y])
    wings = 0.54 * _lobe(((x - wing + 0.022) / 0.024) ** 2 + ((y - tip - 0.010) / 0.026) ** 2, 0.4)
    return high * _joined(_joined(bridge, ball), jnp.sum(wings, axis=0))


def _nostrils(shape: "FaceShape") -> list[Hill]:
    return _both_sides((1.0, 0.1675 * shape.nose_width, shape.nose_y + 0.030, 0.011, 0.006, 0.3))


def _lips(shape: "FaceShape", x: Array, y: Array) -> Array:
    line, upper, lower, u = _lip_lines(shape, x)
    lips = shape.lips * jnp.exp(-1.3 * u**4) * (0.75 * _bell(y - upper, 0.0105) + _bell(y - lower, 0.014))
    return lips - 0.014 * jnp.exp(-((u / 1.02) ** 6)) * _bell(y - line, 0.0045)


def _lip_lines(shape: "FaceShape", x: Array) -> tuple[Array, Array, Array, Array]:
    """Returns the y of the mouth line and of both lips' crests, and x in halves of the mouth's width."""
    u = x / (0.5 * shape.mouth_width)
    line = shape.mouth_y + 0.004 * u * u
    upper = line - 0.016 * (1 - 0.85 * u * u) + 0.005 * _bell(x, 0.012)
    lower = line + 0.021 * (1 - 0.85 * u * u)
    return line, upper, lower, u


def _hills(x: Array, y: Array, hills: Sequence[Hill]) -> Array:
    """Returns the sum of Gaussian hills, in one broadcast: one small program for all of them."""
    numbers = jnp.stack([jnp.stack([jnp.asarray(number, x.dtype) for number in hill]) for hill in hills])
    height, center_x, center_y, along, across, angle = numbers.T.reshape(6, -1, *(1 for _ in x.shape))
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    dx, dy = x[None] - center_x, y[None] - center_y
    u, v = (cosine * dx + sine * dy) / along, (cosine * dy - sine * dx) / across
    return jnp.sum(height * jnp.exp(-0.5 * (u**2 + v**2)), axis=0)


def _both_sides(*hills: Hill) -> list[Hill]:
    """Hills and their mirror images: smooth at x = 0, as a function of |x| would not be."""
    return [*hills, *((height, -x, y, along, across, -angle) for height, x, y, along, across, angle in hills)]


def _bell(t: Array, width) -> Array:
    return jnp.exp(-0.5 * (t / width) ** 2)


def _step(t: Array, width: float) -> Array:
    return 0.5 + 0.5 * jnp.tanh(0.5 / width * t)


def _lobe(q: Array, roundness: float) -> Array:
    """Returns a hill over the squared distance q, flatter on top than a Gaussian."""
    return jnp.exp(-q * (q + 0.15) / (q + roundness))


def _joined(a: Array, b: Array) -> Array:
    return a + b - a * b / 1.06


def _soft_maximum(a: Array, b: Array, width: float) -> Array:
    return width * jnp.logaddexp(a / width, b / width)


def _soft_root(t: Array, softness) -> Array:
    """Returns √t for t well above zero, going to zero smoothly below."""
    return jnp.sqrt(0.5 * (t + jnp.sqrt(t * t + softness * softness)))


def _painted(picture: Array, value: float, cover: Array) -> Array:
    return picture + (value - picture) * cover
