"""Views: which lens-free camera shows a picture without its lens."""

import math
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens.cameras._sight import sight
from jaxlens.diagnostics import zoom_to_fill
from jaxlens.frames import Frame
from jaxlens.lenses import Cylindrical, Equirectangular, Lens, Perspective, Projection, Stereographic
from jaxlens.numerics import is_concrete, join, split

Keep = Literal["same", "valid", "all"]
"""How a view is placed: like the camera itself, showing nothing that was not seen, or all that was."""

ViewProjection = Literal["perspective", "cylindrical", "equirectangular", "stereographic"]
"""What a view is drawn on: a plane, an upright cylinder, longitudes and latitudes, a sphere seen from its back."""

_PROJECTIONS: dict[str, type[Projection]] = {
    "perspective": Perspective,
    "cylindrical": Cylindrical,
    "equirectangular": Equirectangular,
    "stereographic": Stereographic,
}
# Points a side at which a lens is looked at, and those among them that OpenCV looks at: nine a side.
_POINTS, _EVERY = 129, 16
# Straight up and down.
_POLES = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
# Where `zoom_to_fill` ends: a view that can be zoomed out so far has no end.
_SMALLEST_ZOOM = 1e-3


def view_lens_and_frame(
    lens: Lens,
    frame: Frame,
    size: tuple[int, int],
    *,
    keep: str,
    fov: float | int | None,
    new_size: tuple[int, int],
    projection: str,
) -> tuple[Projection, Frame]:
    """Returns the lens and the frame of `Camera.view`; sizes are (width, height)."""
    check_view(keep, fov, projection)
    target = _PROJECTIONS[projection]()
    if fov is not None:
        return target, _frame_of_field(projection, fov, new_size, frame.scale.dtype)
    if keep == "same":
        wide, tall = (new / old for new, old in zip(new_size, size, strict=True))
        return target, frame if new_size == size else frame.stretched(wide, tall)
    rays, ideal = _looked_at(lens, frame, target, size)
    if keep == "all" and is_concrete(rays, lens, frame):
        _check_end(projection, rays, frame.denormalize(lens.project(_POLES)), size)
    if keep == "valid" and is_concrete(ideal) and bool(jnp.any(jnp.isnan(_border(ideal)))):
        zoomed = frame.zoomed(_checked_zoom(zoom_to_fill(sight(lens, target), size[1], size[0], frame=frame)))
        wide, tall = (new / old for new, old in zip(new_size, size, strict=True))
        return target, zoomed.stretched(wide, tall)
    coarse = ideal[::_EVERY, ::_EVERY]
    bounds = _outer if keep == "all" else _inner
    first, last = bounds(ideal)
    if projection == "perspective":
        # OpenCV's numbers, wherever it would have any.
        plain = jnp.all(jnp.isfinite(coarse))
        first, last = (jnp.where(plain, *pair) for pair in zip(bounds(coarse), (first, last), strict=True))
    if is_concrete(first) and not bool(jnp.all(first < last)):
        raise ValueError(
            f"keep={keep!r} finds nothing to show: no rectangle was seen throughout; choose a view by its field, fov=90"
        )
    scale = (jnp.asarray(new_size, frame.scale.dtype) - 1) / (last - first)
    return target, Frame(-scale * first, scale)


def check_view(keep: str, fov: float | int | None, projection: str) -> None:
    """Refuses what no camera can be viewed by.

    Raises:
        ValueError: no such word; `keep` and `fov` at once; a field that the projection does not have.
    """
    for name, value, known in (("keep", keep, get_args(Keep)), ("projection", projection, get_args(ViewProjection))):
        if value not in known:
            raise ValueError(f"{name}={value!r} is none of {', '.join(known)}")
    if fov is None:
        return
    if keep != "same":
        raise ValueError(f"keep={keep!r} and fov={fov!r} are two ways to choose a view: leave one of them out")
    limit = 180 if projection == "perspective" else 360
    closed = projection in ("cylindrical", "equirectangular")
    if not (0 < fov < limit or (closed and fov == limit)):
        other = "; projection='equirectangular' shows up to 360" if projection == "perspective" else ""
        raise ValueError(
            f"fov={fov!r}: the field of a {projection} view is above 0 and {'at most' if closed else 'below'} {limit} "
            f"degrees{other}"
        )


@jax.jit
def _looked_at(
    lens: Lens, frame: Frame, target: Projection, size: tuple[Array, Array]
) -> tuple[Float[Array, "points points 3"], Float[Array, "points points 2"]]:
    """Returns the rays of points all over a picture, centre to centre, and where the view's projection has them."""
    x, y = (jnp.linspace(0, 1, _POINTS, dtype=frame.scale.dtype) * (count - 1) for count in size)
    rays = lens.unproject(frame.normalize(join(*jnp.meshgrid(x, y))))
    return rays, target.project(rays)


def _border(points: Float[Array, "rows columns axes"]) -> Float[Array, "border axes"]:
    return jnp.concatenate([points[0], points[-1], points[:, 0], points[:, -1]])


def _outer(points: Float[Array, "rows columns 2"]) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Returns the corners of the rectangle around points."""
    return jnp.nanmin(points, axis=(0, 1)), jnp.nanmax(points, axis=(0, 1))


def _inner(points: Float[Array, "rows columns 2"]) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Returns the corners of the rectangle between the points of a picture's four sides."""
    x, y = split(points)
    return (
        jnp.stack([jnp.nanmax(x[:, 0]), jnp.nanmax(y[0])]),
        jnp.stack([jnp.nanmin(x[:, -1]), jnp.nanmin(y[-1])]),
    )


def _frame_of_field(projection: str, fov: float | int, size: tuple[int, int], dtype: jnp.dtype) -> Frame:
    """Returns the frame of square pixels with the axis in the middle, of this horizontal field in degrees."""
    half = math.radians(fov) / 2
    extent = {"perspective": math.tan(half), "stereographic": 2 * math.tan(half / 2)}.get(projection, half)
    width, height = size
    scale = width / 2 / extent
    return Frame(np.asarray([(width - 1) / 2, (height - 1) / 2], dtype), np.asarray([scale, scale], dtype))


def _check_end(
    projection: str, rays: Float[Array, "rows columns 3"], poles: Float[Array, "2 2"], size: tuple[int, int]
) -> None:
    """Refuses what has no end on a plane, or on a cylinder."""
    if projection == "perspective" and bool(jnp.any(rays[..., 2] <= 0)):
        raise ValueError(
            "keep='all' in perspective: the picture shows directions past 90° from the lens's axis, which no plane "
            "holds; take projection='equirectangular', 'cylindrical' or 'stereographic', or choose a field, such as "
            "fov=120"
        )
    inside = jnp.all((poles >= 0) & (poles <= jnp.asarray(size, poles.dtype)[None] - 1), axis=-1)
    if projection == "cylindrical" and bool(jnp.any(inside)):
        raise ValueError(
            "keep='all' on a cylinder: the picture shows what is straight above or below, which no upright cylinder "
            "holds; take projection='equirectangular' or 'stereographic', or choose a field, such as fov=180"
        )


def _checked_zoom(zoom: Float[Array, ""]) -> Float[Array, ""]:
    """Refuses a zoom that has no end, or that nothing is seen at."""
    if bool(zoom < _SMALLEST_ZOOM):
        raise ValueError(
            "keep='valid' in perspective: the lens sees so far round its axis that the view has no end; "
            "choose a field, such as fov=120"
        )
    if bool(jnp.isnan(zoom)):
        raise ValueError(
            "keep='valid' finds nothing to show: what the lens sees ends at its axis; choose a view by its field, "
            "fov=90"
        )
    return zoom
