"""What `jaxlens undistort` shows of a picture, and how a picture comes to be what is shown."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from jaxlens.cli.lenses import LensChoice
from jaxlens.cli.messages import UsageError, in_options

if TYPE_CHECKING:
    from jaxlens.cameras import Camera, Keep, ViewProjection
    from jaxlens.frames import Frame
    from jaxlens.maps import CoordinateMap

Direction = Literal["distort", "undistort"]


@dataclass(frozen=True)
class View:
    """What of a picture is shown, as in `Camera.view`; hashable, so that what depends on it is computed once."""

    keep: "Keep" = "same"
    fov: float | None = None
    size: tuple[int, int] | None = None
    projection: "ViewProjection" = "perspective"

    def check(self) -> None:
        """Refuses what no picture can be shown by.

        Raises:
            UsageError: two ways to choose at once, or a field that cannot be.
        """
        if self.fov is None:
            return
        from jaxlens.cameras import check_view

        try:
            check_view(self.keep, self.fov, self.projection)
        except ValueError as error:
            raise UsageError(in_options(error)) from None


# What `jaxlens distort` shows, and `jaxlens undistort` unless told otherwise.
AS_IT_IS = View()


@dataclass(frozen=True)
class Placed:
    """How a picture is warped: the arguments of `jaxlens.images.warp`.

    Attributes:
        mapping: From points of the result to points of the picture.
        frame: Of the picture.
        output_frame: Of the result.
        shape: Height and width of the result.
        camera: Of the result, where it has no lens.
    """

    mapping: "CoordinateMap"
    frame: "Frame"
    output_frame: "Frame"
    shape: tuple[int, int]
    camera: "Camera | None" = None


def place(chosen: LensChoice, direction: Direction, height: int, width: int, view: View) -> Placed:
    """Returns how a picture of that size is put through a lens, in JAX's default float.

    Raises:
        ValueError: as `Camera.view`, or the lens is for pictures of another shape.
    """
    from jaxlens.cameras import Camera, sight

    lens, frame = chosen.place(height, width)
    if direction == "distort":
        return Placed(lens.inverse(), frame, frame, (height, width))
    target = Camera(lens, frame, width, height).view(
        keep=view.keep, fov=view.fov, size=view.size, projection=view.projection
    )
    return Placed(sight(lens, target.lens), frame, target.frame, (target.height, target.width), target)
