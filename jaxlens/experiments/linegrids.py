"""Straight lines under one-parameter lenses, as curves and as pictures, and which way they bend.

A setting says which lens, and whether its factor takes the source to the output (a lens, as everywhere in the
library) or the output to the source (Section 2.4 of the paper). The two name the sign of k the other way round.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens.frames import Frame
from jaxlens.lenses import Division, RadialLens, RadialPolynomial
from jaxlens.maps import CoordinateMap, OneToOne
from jaxlens.warping import distort_image, undistort_image

Setting = Literal["lens", "section 2.4", "division"]
SETTINGS: tuple[Setting, ...] = ("lens", "section 2.4", "division")

HALF = float(np.sqrt(0.5))
"""Half the side of a square whose half diagonal is one, as in Eq. 10."""
_SAMPLES = 801
# The line whose bend is measured: half way out; between its middle and points as far up and down.
_PROBE = 0.5 * HALF
# A row of a picture with less light than this does not show the line.
_DARK = 0.1


@dataclass(frozen=True)
class Bend:
    """How much a vertical line to the right of the centre bends.

    Attributes:
        pixels: How much further out its middle lies than its ends: positive is barrel; NaN where the output does not
            show it.
    """

    pixels: float

    @property
    def name(self) -> str:
        """Barrel, pincushion or straight."""
        if np.isnan(self.pixels):
            return "not shown"
        return "straight" if abs(self.pixels) < 1e-3 else "barrel" if self.pixels > 0 else "pincushion"


def lens_of(setting: Setting, k: float) -> RadialLens:
    """Returns the lens of a setting."""
    return Division(k) if setting == "division" else RadialPolynomial([k])


def forward(setting: Setting, k: float) -> CoordinateMap:
    """Returns the map that takes source points to output points; NaN where the output shows none."""
    lens = lens_of(setting, k)
    return lens.inverse() if setting == "section 2.4" else OneToOne(lens)


def curves(setting: Setting, k: float, lines: int) -> list[Float[np.ndarray, "samples 2"]]:
    """Returns a grid's lines in the output, normalized coordinates, first the vertical and then the horizontal ones."""
    along = jnp.linspace(-HALF, HALF, _SAMPLES)
    mapping, found = forward(setting, k), []
    for vertical in (True, False):
        for at in np.linspace(-HALF, HALF, lines):
            across = jnp.full_like(along, at)
            points = jnp.stack([across, along] if vertical else [along, across], axis=-1)
            found.append(np.asarray(mapping(points)))
    return found


def straight_picture(lines: int, size: int) -> Float[Array, "size size"]:
    """Returns a picture of a grid: dark lines on white."""
    x, y = _normalized(size)
    at = jnp.linspace(-HALF, HALF, lines)[:, None, None]
    distance = jnp.min(jnp.minimum(jnp.abs(x[None] - at), jnp.abs(y[None] - at)), axis=0)
    pixel = 2 * HALF / size
    return jnp.clip(distance / pixel - 0.75, 0, 1)


def picture(setting: Setting, k: float, image: Float[Array, "size size"]) -> Float[Array, "size size"]:
    """Returns a picture through the setting's lens; black where it has no source."""
    lens = lens_of(setting, k)
    return undistort_image(image, lens) if setting == "section 2.4" else distort_image(image, lens)


def bend_of_curve(setting: Setting, k: float, size: int) -> Bend:
    """Measures the bend on a line that is pushed forward."""
    along = jnp.linspace(-HALF, HALF, _SAMPLES)
    x, y = np.asarray(forward(setting, k)(jnp.stack([jnp.full_like(along, _PROBE), along], axis=-1))).T
    return Bend(_middle_less_end(y, x, [0.0, _PROBE]) * _scale(size))


def bend_of_picture(setting: Setting, k: float, size: int) -> Bend:
    """Measures the bend on a picture of the line that is warped: the centre of its light, row by row."""
    x, _ = _normalized(size)
    width = 2 / _scale(size)
    warped = np.asarray(picture(setting, k, jnp.exp(-0.5 * ((x - _PROBE) / width) ** 2)))
    columns = np.arange(size)
    total = warped.sum(axis=1)
    centers = np.where(total > _DARK, warped @ columns / np.where(total > _DARK, total, 1), np.nan)
    frame = Frame.half_diagonal(size, size)
    rows = np.asarray(frame.denormalize(jnp.array([[0.0, 0.0], [0.0, _PROBE]])))[:, 1]
    return Bend(_middle_less_end(columns, centers, rows))


def _middle_less_end(y: np.ndarray, x: np.ndarray, at: Sequence[float] | np.ndarray) -> float:
    """The x of a curve at a first y less that at a second; NaN where the curve does not reach."""
    seen = np.isfinite(x)
    if not seen.any():
        return float("nan")
    found = np.interp(np.asarray(at), y[seen], x[seen], left=np.nan, right=np.nan)
    return float(found[0] - found[1])


def _normalized(size: int) -> tuple[Float[Array, "size size"], Float[Array, "size size"]]:
    x, y = jnp.meshgrid(jnp.arange(float(size)), jnp.arange(float(size)))
    points = Frame.half_diagonal(size, size).normalize(jnp.stack([x, y], axis=-1))
    return points[..., 0], points[..., 1]


def _scale(size: int) -> float:
    """Pixels per unit."""
    return size * HALF
