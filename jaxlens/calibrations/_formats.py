"""Reading and writing calibrations, in whichever of the formats: what a file is, its content says."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from jaxlens.calibrations import _colmap, _kalibr, _lens_json, _metashape, _mrcal, _opencv, _ros, _transforms
from jaxlens.calibrations._calibration import Calibration, CalibrationError
from jaxlens.calibrations._documents import Document
from jaxlens.calibrations._keys import shown
from jaxlens.files import atomic_write

if TYPE_CHECKING:
    from jaxlens.cameras import Camera


@dataclass(frozen=True)
class _Format:
    """A format: what it is called, whether a file is one of it, its reader and its writer."""

    name: str
    recognizes: Callable[[Document], bool]
    parse: Callable[[Document], list[Calibration]]
    render: Callable[[Sequence[Calibration]], str | bytes]


# The first that recognizes a file reads it: those that say what they are come before those known by a few keys.
_FORMATS = (
    _Format("jaxlens", _lens_json.recognizes, _lens_json.parse, _lens_json.render),
    _Format("colmap-binary", _colmap.recognizes_binary, _colmap.parse_binary, _colmap.render_binary),
    _Format("colmap", _colmap.recognizes_text, _colmap.parse_text, _colmap.render_text),
    _Format("ros", _ros.recognizes, _ros.parse, _ros.render),
    _Format("kalibr", _kalibr.recognizes, _kalibr.parse, _kalibr.render),
    _Format("mrcal", _mrcal.recognizes, _mrcal.parse, _mrcal.render),
    _Format("metashape", _metashape.recognizes, _metashape.parse, _metashape.render),
    _Format("nerfstudio", _transforms.recognizes, _transforms.parse, _transforms.render),
    _Format("opencv-yaml", _opencv.recognizes_as(""), _opencv.parse, _opencv.render_yaml),
    _Format("opencv-xml", _opencv.recognizes_as("<"), _opencv.parse, _opencv.render_xml),
    _Format("opencv-json", _opencv.recognizes_as("{"), _opencv.parse, _opencv.render_json),
)


def formats() -> tuple[str, ...]:
    """Returns the names of the formats that are read and written."""
    return tuple(one.name for one in _FORMATS)


def read(path: str | os.PathLike[str]) -> list[Calibration]:
    """Reads the cameras of a file, in whichever of the `formats` it is: its content says, not its suffix.

    Pixels, axes and signs become ours (`docs/conventions.md`); `docs/formats.md` says what each format needs for that.

    Args:
        path: The file. Nothing in it is run, and its size, depth and numbers are bounded.

    Returns:
        The cameras, one or more, in the file's order.

    Raises:
        CalibrationError: no such file, no format that is known, or a file that is wrong; the message names the file
            and the line, or the key and its value.

    Example:
        >>> import jaxlens as jl, pathlib, tempfile
        >>> camera = jl.Camera(jl.BrownConrady([-0.25, 0.0625, 0.0, 0.0]), jl.Frame([319.5, 239.5], 512.0), 640, 480)
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "camera.yaml"
        >>> jl.calibrations.write(path, camera, format="opencv-yaml")
        >>> [found] = jl.calibrations.read(path)
        >>> found.format, found.model, found.image_size
        ('opencv-yaml', 'BrownConrady', (640, 480))
    """
    document = Document.open(path)
    try:
        for one in _FORMATS:
            if one.recognizes(document):
                return [replace(found, format=one.name) for found in one.parse(document)]
        found = document.values
    except RecursionError:
        raise CalibrationError(f"{document.name} is no calibration: it is nested too deeply") from None
    listed = ", ".join(formats())
    there = f"has the keys {', '.join(map(str, list(found)[:12]))}" if isinstance(found, dict) else f"is {shown(found)}"
    raise CalibrationError(f"{document.name} is no calibration of a known format ({listed}): it {there}")


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Reads the one camera of a file, in whichever of the `formats` it is.

    Args:
        path: The file.

    Raises:
        CalibrationError: as `read`, or the file holds several cameras.
    """
    found = read(path)
    if len(found) > 1:
        raise CalibrationError(
            f"{str(path)!r} holds {len(found)} cameras ({', '.join(one.name for one in found[:12])}), and one is "
            "needed: write the one to a file of its own, by calibrations.read and calibrations.write"
        )
    return found[0]


def write(
    path: str | os.PathLike[str],
    cameras: "Calibration | Camera | Sequence[Calibration | Camera]",
    *,
    format: str = "jaxlens",
    overwrite: bool = False,
) -> None:
    """Writes cameras in one of the `formats`, whole or not at all; the same cameras are the same bytes.

    Pixels, axes and signs become the format's. A lens is written as another family only where that is exactly the same.

    Args:
        path: The file.
        cameras: A calibration or a camera, or several, where the format holds several.
        format: One of `formats()`; a calibration's `format` is that of the file that it came from.
        overwrite: Replace an existing file.

    Raises:
        CalibrationError: no such format; a lens that it has no room for, which the message tells, `fitting.convert`
            finds the nearest one; no frame or no image size where the format needs it; a number that is not finite.
        OSError: as `jaxlens.files.atomic_write`.
    """
    chosen = {one.name: one for one in _FORMATS}.get(format)
    if chosen is None:
        raise CalibrationError(f"there is no format {format!r}; there are {', '.join(formats())}")
    listed = list(cameras) if isinstance(cameras, Sequence) else [cameras]
    if not listed:
        raise CalibrationError("no cameras to write: pass at least one")
    plain = [one if isinstance(one, Calibration) else Calibration.from_camera(one) for one in listed]
    for one in plain:
        _check_finite(one)
    content = chosen.render(plain)
    with atomic_write(path, overwrite=overwrite) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def write_calibration(path: str | os.PathLike[str], calibration: Calibration, *, overwrite: bool = False) -> None:
    """Writes one calibration as jaxlens's own JSON, which keeps all that is known of it (see `write`)."""
    write(path, calibration, overwrite=overwrite)


def _check_finite(calibration: Calibration) -> None:
    numbers = [*(calibration.center or ()), *(calibration.scale or ())]
    for _, value in calibration.parameters:
        numbers += value if isinstance(value, tuple) else [value]
    if not all(map(math.isfinite, numbers)):
        raise CalibrationError("the calibration has a number that is not finite; a fit that failed is not written")
