"""Pictures of a face that change smoothly with a few numbers: how it is framed, lit and exposed.

The face is sampled once, as it is; a picture is cut out of that, lit, and put on a background. Pictures stand on a
square grid of pixels, whatever their aspect: a mean over them is a mean over the picture.
"""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens.sampling import remap
from jaxlens.surfaces import FaceShape, face, face_albedo, normals, shade

# What the samples of the face show, in head heights, and how many of them are averaged along each side of a pixel.
_VIEW = 1.1
_SUPERSAMPLED = 4
# Least brightness under a power.
_DARK = 1e-4


@dataclass(frozen=True)
class Parameter:
    """A number that a picture depends on.

    Attributes:
        name: In tables; `log_` in front where the fit knows its logarithm.
        meaning: In words, with its unit.
        middle: What is expected before the table is known, and by how much it may differ (standard deviation).
        spread: That.
        lower: The least that is allowed.
        upper: The largest.
    """

    name: str
    meaning: str
    middle: float
    spread: float
    lower: float
    upper: float

    def shown(self, value: float) -> float:
        """Returns the number as people read it: logarithms undone."""
        return float(np.exp(value)) if self.name.startswith("log_") else float(value)


PARAMETERS = (
    Parameter("log_view", "height of the picture [head heights]", 0.14, 0.3, -0.7, 1.0),
    Parameter("x", "face right of the middle [heights]", 0.0, 0.1, -0.4, 0.4),
    Parameter("y", "face below the middle [heights]", 0.0, 0.1, -0.4, 0.4),
    Parameter("background", "background [of the brightest skin]", 0.5, 0.5, 0.0, 1.5),
    Parameter("light_x", "light from the right [slope]", 0.0, 0.5, -2.0, 2.0),
    Parameter("light_y", "light from below [slope]", 0.0, 0.5, -2.0, 2.0),
    Parameter("ambient", "ambient light [share]", 0.3, 0.2, 0.0, 1.0),
    Parameter("log_gamma", "contrast (gamma)", 0.0, 0.3, -1.0, 1.0),
    Parameter("log_aspect", "width / height", 0.0, 0.2, -0.5, 0.5),
)
"""What pictures depend on. Light of slope one comes from 45° to the line of sight."""

Vector = Float[Array, " parameters"]


class Template(eqx.Module):
    """A face as it is, before it is framed and lit.

    Attributes:
        planes: `(H, W, 5)`: the share of a pixel that the face covers, the reflected share of light, and the normal
            (x, y, z).
    """

    planes: Float[Array, "height width 5"]

    @classmethod
    def of(cls, height: int, dtype: str, shape: FaceShape | None = None) -> "Template":
        """Samples a face, `height` pixels for 1.1 head heights, antialiased.

        The features of `FaceShape` are smooth; its outline is not, and neither is a picture that shifts by less than
        a pixel.
        """
        width = -(-3 * height // 4)
        tall, wide = _SUPERSAMPLED * height, _SUPERSAMPLED * width
        surface = face(tall, wide, shape=shape, view=_VIEW)
        covered = surface.mask.astype(dtype)[..., None]
        normal = normals(surface).astype(dtype)
        share = _mean(covered)
        outwards = _mean(covered * normal)
        length = jnp.sqrt(jnp.sum(outwards**2, axis=-1, keepdims=True))
        # Off the face any will do, and this is not to bend what is read between pixels.
        ahead = jnp.asarray([0, 0, 1], dtype)[None, None]
        outwards = jnp.where(share > 0, outwards / jnp.where(length > 0, length, 1), ahead)
        reflected = _mean(face_albedo(tall, wide, shape=shape, view=_VIEW).astype(dtype)[..., None])
        return cls(jnp.concatenate([share, reflected, outwards], axis=-1))


def _mean(planes: Array) -> Array:
    height, width, channels = planes.shape
    n = _SUPERSAMPLED
    return jnp.mean(planes.reshape(height // n, n, width // n, n, channels), axis=(1, 3))


def render(template: Template, parameters: Vector, size: int, peak: float) -> Float[Array, "size size"]:
    """Makes a picture on a square grid of pixels, its brightest at the peak.

    Smooth in the parameters but where the light grazes the surface, and where another pixel becomes the brightest.
    """
    view, aspect, gamma = (jnp.exp(parameters[_index(f"log_{name}")]) for name in ("view", "aspect", "gamma"))
    x, y, background, light_x, light_y, ambient = (
        parameters[_index(name)] for name in ("x", "y", "background", "light_x", "light_y", "ambient")
    )
    height, width = template.planes.shape[:2]
    steps = (jnp.arange(size, dtype=parameters.dtype) - 0.5 * (size - 1)) / size
    columns = 0.5 * (width - 1) + (steps * aspect - x) * (view / _VIEW * height)
    rows = 0.5 * (height - 1) + (steps - y) * (view / _VIEW * height)
    coordinates = jnp.stack(jnp.meshgrid(columns, rows), axis=-1)
    cover, albedo, *normal = jnp.moveaxis(
        remap(template.planes, coordinates, method="bicubic", border="constant"), -1, 0
    )
    cover = jnp.clip(cover, 0, 1)
    length = jnp.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2 + 1e-6)
    facing = (normal[0] * light_x + normal[1] * light_y + normal[2]) / length
    facing = facing / jnp.sqrt(1 + light_x**2 + light_y**2)
    lit = albedo * (ambient + (1 - ambient) * jnp.maximum(facing, 0))
    skin = jnp.maximum(lit, _DARK) ** gamma
    picture = cover * skin / jnp.max(cover * skin) + (1 - cover) * background
    return peak * picture / jnp.max(picture)


def render_fine(parameters: Float[np.ndarray, " parameters"], height: int, peak: float) -> np.ndarray:
    """Makes the same picture with square pixels and whole gray levels, by `face` and `shade` themselves.

    Args:
        parameters: Of the picture.
        height: In pixels; its width follows from the aspect.
        peak: The brightest gray level.
    """
    values = {
        one.name.removeprefix("log_"): one.shown(value) for one, value in zip(PARAMETERS, parameters, strict=True)
    }
    width = max(1, round(height * values["aspect"]))
    # Larger than the picture, so that no detail is lost between its pixels; its shape is the same for all pictures.
    tall, wide = 2 * height, -(-3 * height // 2)
    surface = face(tall, wide, view=_VIEW)
    lit = shade(
        surface,
        light=[values["light_x"], values["light_y"], 1.0],
        ambient=values["ambient"],
        albedo=face_albedo(tall, wide, view=_VIEW),
    )
    skin = np.maximum(np.asarray(lit), _DARK) ** values["gamma"]
    step = values["view"] / _VIEW * tall / height
    columns = (np.arange(width) - 0.5 * (width - 1) - values["x"] * height) * step + 0.5 * (wide - 1)
    rows = (np.arange(height) - 0.5 * (height - 1) - values["y"] * height) * step + 0.5 * (tall - 1)
    places = np.stack(np.meshgrid(columns, rows), axis=-1)
    cover = np.asarray(surface.mask, skin.dtype)
    planes = np.asarray(remap(np.stack([cover, cover * skin], axis=-1), places))
    picture = planes[..., 1] / planes[..., 1].max() + (1 - planes[..., 0]) * values["background"]
    return np.round(peak * picture / picture.max())


def random_parameters(count: int, seed: int) -> Float[np.ndarray, "count parameters"]:
    """Draws from what is expected before the table is known, within the bounds."""
    middle, spread, lower, upper = bounds()
    drawn = middle + spread * np.random.default_rng(seed).standard_normal((count, len(PARAMETERS)))
    return np.clip(drawn, lower, upper)


def bounds() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns the middles, spreads, lower and upper bounds of all parameters."""
    rows = [(one.middle, one.spread, one.lower, one.upper) for one in PARAMETERS]
    middle, spread, lower, upper = np.array(rows).T
    return middle, spread, lower, upper


def _index(name: str) -> int:
    return next(index for index, one in enumerate(PARAMETERS) if one.name == name)
