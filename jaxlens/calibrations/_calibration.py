"""A lens as plain numbers, for files: no JAX until the lens itself is asked for."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxlens.fitting import Fit
    from jaxlens.frames import Frame
    from jaxlens.lenses import Lens
    from jaxlens.maps import CoordinateMap

Value = float | tuple[float, ...]

MODELS = ("BrownConrady", "Division", "RadialPolynomial")
"""The lenses that files hold, by the names of their classes."""

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
        model: The class of the lens, one of `MODELS`.
        parameters: The arguments that make it, by name.
        center: The frame's centre (x, y) in pixels, pixel centres at integers; None where no frame is known.
        scale: The frame's pixels per normalized unit along x and y.
        image_size: (width, height) in pixels of the pictures that it is for, if known.
        estimate: What a fit found out, if one did.
    """

    model: str
    parameters: tuple[tuple[str, Value], ...]
    center: tuple[float, float] | None = None
    scale: tuple[float, float] | None = None
    image_size: tuple[int, int] | None = None
    estimate: Estimate | None = None

    @classmethod
    def from_lens(
        cls, lens: "CoordinateMap", *, frame: "Frame | None" = None, image_size: tuple[int, int] | None = None
    ) -> "Calibration":
        """Returns the calibration of a lens.

        Raises:
            CalibrationError: a kind of lens that files do not hold.
        """
        import numpy as np

        model = type(lens).__name__
        if model not in MODELS:
            raise CalibrationError(f"a calibration holds {', '.join(MODELS)}, not {model}")
        parameters = {name: np.asarray(value, np.float64).tolist() for name, value in vars(lens).items()}
        pairs = tuple(
            (name, tuple(value) if isinstance(value, list) else value) for name, value in sorted(parameters.items())
        )
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
        import jaxlens

        if self.model not in MODELS:
            raise CalibrationError(f"a calibration holds {', '.join(MODELS)}, not {self.model}")
        try:
            lens = getattr(jaxlens, self.model)(**dict(self.parameters))
        except (TypeError, ValueError) as error:
            raise CalibrationError(f"no {self.model} has such parameters: {error}") from error
        return lens

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
        wide, tall = width / own_width, height / own_height
        # Pixel centres at integers: it is the corners at −1/2 that keep their place.
        center = ((self.center[0] + 0.5) * wide - 0.5, (self.center[1] + 0.5) * tall - 0.5)
        return Frame(center, (self.scale[0] * wide, self.scale[1] * tall))
