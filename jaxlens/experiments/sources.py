"""The images of experiments, as arrays: read or made, cropped, turned gray, scaled.

JAX is imported by the functions that need it: kinds of experiments import this module before their file is checked.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Real

from jaxlens import images
from jaxlens.experiments.config import Configuration
from jaxlens.experiments.errors import ConfigError, ExperimentError
from jaxlens.experiments.schema import Crop, Image
from jaxlens.files import file_sha256

_LUMA = np.array([0.299, 0.587, 0.114])  # Rec. 601
_PORTRAIT = "grace_hopper.jpg"


@dataclass(frozen=True, eq=False)
class Source:
    """An image ready for an experiment.

    Attributes:
        label: What figures and tables call it.
        pixels: `(H, W)` or `(H, W, C)`, floating.
        peak: L of the PSNR.
        facts: For the manifest: file, checksums, shape, crop.
    """

    label: str
    pixels: Float[np.ndarray, "height width *channels"]
    peak: float
    facts: dict[str, object]

    @property
    def gray(self) -> Float[np.ndarray, "height width"]:
        """The pixels, their channels averaged."""
        return self.pixels if self.pixels.ndim == 2 else self.pixels.mean(axis=-1)


def load_source(configuration: Configuration, image: Image) -> Source:
    """Reads or makes an image as the configuration says.

    Raises:
        ConfigError: the crop does not fit into the image.
        ExperimentError: the picture cannot be read, is transparent, or is black and was to be scaled.
    """
    path = (
        _portrait() if image.source == "portrait" else (None if image.path is None else configuration.file(image.path))
    )
    if path is None:
        seed = configuration.experiment.seed
        pixels, peak = _pattern(image, seed), 1.0
        facts: dict[str, object] = {"source": image.source}
    else:
        raw = _read(path)
        pixels, peak = raw.astype(np.float64), _range(raw)
        facts = {"file": path.name, "sha256": file_sha256(path)}
    if image.crop is not None:
        pixels = _crop(pixels, image.crop, configuration, image)
    if image.gray and pixels.ndim == 3:
        pixels = pixels @ _LUMA
    if image.peak is not None:
        largest = float(pixels.max())
        if largest <= 0:
            raise ExperimentError(f"{image.label}: the image is black, and cannot be scaled to peak {image.peak:g}")
        pixels, peak = pixels * (image.peak / largest), image.peak
    facts |= {
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "peak": peak,
        "root_mean_square": float(np.sqrt(np.mean(pixels**2))),
        "pixels_sha256": hashlib.sha256(np.ascontiguousarray(pixels, "<f8").tobytes()).hexdigest(),
    }
    return Source(image.label, pixels.astype(configuration.experiment.dtype), peak, facts)


def _portrait() -> Path:
    from matplotlib import get_data_path

    path = Path(get_data_path()) / "sample_data" / _PORTRAIT
    if not path.is_file():
        raise ExperimentError(
            f"matplotlib is installed without its sample data ({_PORTRAIT}); install it from PyPI, or give an image"
        )
    return path


def _read(path: Path) -> Real[np.ndarray, "height width *channels"]:
    try:
        picture = images.read(path)
    except images.ImageError as error:
        raise ExperimentError(str(error)) from None
    pixels = picture.pixels
    if not picture.has_alpha:
        return pixels
    opaque = _range(pixels)
    if (pixels[..., -1] != opaque).any():
        raise ExperimentError(f"{path.name}: has transparent pixels; put it on a background first")
    return pixels[..., 0] if pixels.shape[-1] == 2 else pixels[..., :-1]


def _range(pixels: Real[np.ndarray, "height width *channels"]) -> float:
    """The largest value of an integer dtype; of a floating image, its own largest, 1 if that is less."""
    if np.issubdtype(pixels.dtype, np.integer):
        return float(np.iinfo(pixels.dtype).max)
    return max(1.0, float(pixels.max()))


def _crop(
    pixels: Float[np.ndarray, "height width *channels"], crop: Crop, configuration: Configuration, image: Image
) -> Float[np.ndarray, "new_height new_width *channels"]:
    bottom, right = crop.top + crop.height, crop.left + crop.width
    if bottom > pixels.shape[0] or right > pixels.shape[1]:
        raise ConfigError(
            f"{configuration.path}: image '{image.label}': crop: got rows {crop.top} to {bottom} and columns "
            f"{crop.left} to {right}; must lie within the image's {pixels.shape[0]} rows and {pixels.shape[1]} columns"
        )
    return pixels[crop.top : bottom, crop.left : right]


def _pattern(image: Image, seed: int) -> Float[np.ndarray, "height width"]:
    """A picture of the configured size, values in [0, 1]."""
    height, width = image.height or 1, image.width or 1
    if image.source == "face":
        return _face(height, width)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - (width - 1) / 2, y - (height - 1) / 2
    size = max(height, width)
    if image.source == "checkerboard":
        return ((np.floor(8 * x / size) + np.floor(8 * y / size)) % 2 == 0).astype(np.float64)
    return _head(x / height, y / height) if image.source == "head" else _clouds(height, width, seed)


def _face(height: int, width: int) -> Float[np.ndarray, "height width"]:
    """The face of `jaxlens.surfaces`, lit from the upper left; the same in every experiment's dtype."""
    import jax

    from jaxlens.surfaces import face, face_albedo, shade

    with jax.enable_x64(True):
        return np.asarray(shade(face(height, width), albedo=face_albedo(height, width)))


def _head(
    x: Float[np.ndarray, "height width"], y: Float[np.ndarray, "height width"]
) -> Float[np.ndarray, "height width"]:
    """An egg-shaped head on black, lit from the front, with dark eyes and mouth; 0.9 of the frame high."""
    high, wide = 0.45, 0.3375  # half axes, 4 : 3
    squared = (x / wide) ** 2 + (y / high) ** 2
    shade = np.where(squared < 1, 0.3 + 0.7 * np.sqrt(np.clip(1 - squared, 0, None)), 0)
    eyes = ((np.abs(x) / wide - 0.4) / 0.2) ** 2 + ((y / high + 0.2) / 0.09) ** 2 < 1
    mouth = (x / wide / 0.4) ** 2 + ((y / high - 0.5) / 0.07) ** 2 < 1
    return np.where(eyes | mouth, 0.2, shade)


def _clouds(height: int, width: int, seed: int) -> Float[np.ndarray, "height width"]:
    """Random phases under the 1 / f amplitude that photographs have on average."""
    noise = np.random.default_rng(seed).standard_normal((height, width))
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None, :])
    frequency[0, 0] = np.inf
    clouds = np.fft.ifft2(np.fft.fft2(noise) / frequency).real
    low, high = clouds.min(), clouds.max()
    return (clouds - low) / (high - low) if high > low else np.ones_like(clouds)
