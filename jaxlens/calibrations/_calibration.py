"""A lens as plain numbers, for files: no JAX until the lens itself is asked for."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxlens.cameras import Camera
    from jaxlens.fitting import Fit
    from jaxlens.frames import Frame
    from jaxlens.lenses import Lens
    from jaxlens.maps import CoordinateMap

Value = float | tuple[float, ...]

# Two sizes have one shape if their ratios agree to half a pixel.
_HALF = 0.5


class CalibrationError(ValueError):
    """A file that is no calibration, or a calibration that does not fit; the message says what, where and why."""


@dataclass(frozen=True)
class Estimate:
    """What a fit found out about its parameters.

    Attributes:
        names: The parameters.
        values: Their values.
        covariance: Their covariance, row by row.
        rms: The root of the mean squared residual.
        degrees_of_freedom: n − p.
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    rms: float
    degrees_of_freedom: int


@dataclass(frozen=True)
class Calibration:
    """A lens, the frame that ties it to pixels, and how well it is known. Hashable, and free of JAX.

    Attributes:
        model: The lens's name in files, one of `jaxlens.lenses.registered`.
        parameters: The arguments that make it, by name.
        center: The frame's centre (x, y) in pixels, pixel centres at integers; None where no frame is known.
        scale: The frame's pixels per normalized unit along x and y.
        image_size: (width, height) in pixels of the pictures that it is for, if known.
        estimate: What a fit found out, if one did.
        name: What the file calls the camera, if it does.
        from_previous: The rigid 4 × 4 matrix, row by row, from the coordinates of the camera before this one to this
            one's, where a file says it (Kalibr's `T_cn_cnm1`).
        format: The format of the file that it was read from; it does not count when two are compared.
    """

    model: str
    parameters: tuple[tuple[str, Value], ...]
    center: tuple[float, float] | None = None
    scale: tuple[float, float] | None = None
    image_size: tuple[int, int] | None = None
    estimate: Estimate | None = None
    name: str = ""
    from_previous: tuple[tuple[float, ...], ...] | None = None
    format: str = field(default="", compare=False)

    @classmethod
    def from_camera(cls, camera: "Camera", *, name: str = "") -> "Calibration":
        """Returns the calibration of a camera.

        Raises:
            CalibrationError: as `from_lens`.
        """
        plain = cls.from_lens(camera.lens, frame=camera.frame, image_size=(camera.width, camera.height))
        return replace(plain, name=name)

    @classmethod
    def from_lens(
        cls, lens: "CoordinateMap", *, frame: "Frame | None" = None, image_size: tuple[int, int] | None = None
    ) -> "Calibration":
        """Returns the calibration of a lens.

        Raises:
            CalibrationError: a kind of lens that files do not hold, or one whose fields do not make it again.
        """
        import numpy as np

        model, pairs = _as_numbers(lens)
        if frame is None:
            return cls(model, pairs, image_size=image_size)
        (x, y), (wide, tall) = (np.asarray(part, np.float64).tolist() for part in (frame.center, frame.scale))
        return cls(model, pairs, (x, y), (wide, tall), image_size)

    @classmethod
    def from_fit(cls, fit: "Fit", *, image_size: tuple[int, int] | None = None) -> "Calibration":
        """Returns the calibration that a fit has found, with its covariance."""
        import numpy as np

        plain = cls.from_lens(fit.lens, frame=fit.frame, image_size=image_size)
        estimate = Estimate(
            fit.names,
            tuple(np.asarray(fit.values, np.float64).tolist()),
            tuple(tuple(row) for row in np.asarray(fit.covariance, np.float64).tolist()),
            float(fit.rms),
            int(fit.degrees_of_freedom),
        )
        return cls(plain.model, plain.parameters, plain.center, plain.scale, image_size, estimate)

    def lens(self) -> "Lens":
        """Returns the lens, in JAX's default float.

        Raises:
            CalibrationError: the parameters make no such lens.
        """
        model = check_model(self.model)
        try:
            return model(**dict(self.parameters))
        except (TypeError, ValueError) as error:
            raise CalibrationError(f"no {self.model} has such parameters: {error}") from error

    def frame(self, height: int, width: int) -> "Frame":
        """Returns the frame for a picture of that size: scaled with it, Eq. 10's where none is known.

        Raises:
            CalibrationError: the picture has another shape than those that the calibration is for.
        """
        from jaxlens.frames import Frame

        if self.center is None or self.scale is None:
            return Frame.half_diagonal(height, width)
        if self.image_size is None or self.image_size == (width, height):
            return Frame(self.center, self.scale)
        own_width, own_height = self.image_size
        if abs(width * own_height - height * own_width) > _HALF * (own_height + own_width):
            raise CalibrationError(
                f"the calibration is for pictures of {own_width} × {own_height} pixels, and this one has "
                f"{width} × {height}: another shape, so it was cut or is another camera's"
            )
        return Frame(self.center, self.scale).stretched(width / own_width, height / own_height)

    def camera(self, height: int | None = None, width: int | None = None) -> "Camera":
        """Returns the camera for pictures of that size, or for those that the calibration is for.

        Raises:
            CalibrationError: no size is given, and none is known; as `frame` and `lens`.
        """
        from jaxlens.cameras import Camera

        if height is None or width is None:
            if self.image_size is None:
                raise CalibrationError(
                    "the calibration does not say how large its pictures are: give their size, camera(height, width)"
                )
            width, height = self.image_size
        return Camera(self.lens(), self.frame(height, width), width, height)


def check_model(name: str) -> "type[Lens]":
    """Returns the lens that a file calls by this name; nothing is imported for its sake.

    Raises:
        CalibrationError: nobody has registered it.
    """
    from jaxlens.lenses import registered

    known = registered()
    if name not in known:
        raise CalibrationError(
            f"there is no lens {name!r}; there are {', '.join(known)}. One of your own is known once the module that "
            "registers it has been imported"
        )
    return known[name]


def _as_numbers(lens: "CoordinateMap") -> tuple[str, tuple[tuple[str, Value], ...]]:
    """Returns a lens's name in files, and the arguments that make it again."""
    import dataclasses
    import inspect

    import numpy as np

    from jaxlens.lenses import Lens, registered_name

    kind = type(lens)
    if not isinstance(lens, Lens):
        raise CalibrationError(f"a calibration holds a lens, not a {kind.__name__}")
    try:
        model = registered_name(type(lens))
    except ValueError as error:
        raise CalibrationError(str(error)) from error
    parameters: dict[str, Value] = {}
    for one in dataclasses.fields(kind):
        if one.metadata.get("static", False):
            raise CalibrationError(f"{kind.__name__}.{one.name} is static: files hold numbers, and lists of them")
        value = np.asarray(getattr(lens, one.name), np.float64)
        if value.ndim > 1:
            raise CalibrationError(
                f"{kind.__name__}.{one.name} has shape {value.shape}: files hold numbers, and lists of them"
            )
        parameters[one.name] = tuple(value.tolist()) if value.ndim else float(value)
    try:
        inspect.signature(kind).bind(**parameters)
    except TypeError as error:
        raise CalibrationError(
            f"{kind.__name__} cannot be read back: its constructor must take its fields by name, and says: {error}"
        ) from error
    return model, tuple(sorted(parameters.items()))
