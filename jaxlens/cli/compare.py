"""`jaxlens compare`: every metric of a picture against a reference."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

from tyro.conf import Positional, arg

from jaxlens.cli import options
from jaxlens.cli.inputs import check_file, read_picture
from jaxlens.cli.messages import UsageError, describe
from jaxlens.cli.progress import progress_of

if TYPE_CHECKING:
    from jaxlens.images import Picture

HELP = """Measure how far a picture is from a reference of the same size and kind.

What it does:
  Every channel counts alike, alpha too. The data range is the L of PSNR and
  SSIM: 255 with 8 bits and 65535 with 16; for floating pictures it must be
  given, for they do not say what white is. UQI needs 8 × 8 pixels and SSIM
  11 × 11; in smaller pictures they are NaN. With --json, the numbers that
  JSON does not have are the strings "Infinity", "-Infinity" and "NaN".

Examples:
  jaxlens compare portrait.png restored.png
  jaxlens compare portrait.tif restored.tif --data-range 1.0 --json"""


@dataclass(frozen=True)
class Arguments:
    """Measure how far a picture is from a reference."""

    reference: Annotated[Path, Positional, arg(metavar="REFERENCE", help_behavior_hint="")]
    """The picture as it should be."""

    image: Annotated[Path, Positional, arg(metavar="IMAGE", help_behavior_hint="")]
    """The picture to measure."""

    data_range: Annotated[
        Optional[float], arg(metavar="X", help_behavior_hint="(default: 255 with 8 bits, 65535 with 16)")
    ] = None
    """The difference between white and black, in gray levels."""

    json: Annotated[bool, arg(help_behavior_hint="")] = False
    """Print JSON in place of a table."""

    max_pixels: options.MaxPixels = None


def run(arguments: Arguments) -> int:
    """Runs the command; returns the exit code."""
    if arguments.data_range is not None and not 0 < arguments.data_range < math.inf:
        raise UsageError(f"--data-range is a number above 0, got {arguments.data_range}")
    options.check_max_pixels(arguments.max_pixels)
    check_file(arguments.reference)
    check_file(arguments.image)
    reference = read_picture(arguments.reference, arguments.max_pixels)
    image = read_picture(arguments.image, arguments.max_pixels)
    _check_alike(arguments, reference, image)
    data_range = _data_range(arguments, reference)
    scores = _evaluate(reference, image, data_range)
    if arguments.json:
        _print_json(arguments, reference, data_range, scores)
    else:
        _print_table(arguments, reference, data_range, scores)
    return 0


def _check_alike(arguments: Arguments, reference: "Picture", image: "Picture") -> None:
    first, second = reference.pixels, image.pixels
    if first.shape == second.shape and (first.dtype == second.dtype or _both_float(first, second)):
        return
    if first.shape[:2] != second.shape[:2]:
        advice = "crop or resize one of them first"
    elif first.shape != second.shape:
        advice = "give both the same channels first"
    else:
        advice = "their scales differ; give both the same bits first"
    raise UsageError(
        f"{str(arguments.reference)!r} is {describe(reference)}, and {str(arguments.image)!r} is {describe(image)}: "
        f"they cannot be compared pixel by pixel; {advice}"
    )


def _both_float(first: Any, second: Any) -> bool:
    return first.dtype.kind == second.dtype.kind == "f"


def _data_range(arguments: Arguments, picture: "Picture") -> float:
    import numpy as np

    dtype = picture.pixels.dtype
    if arguments.data_range is not None:
        return arguments.data_range
    if dtype.kind == "f":
        raise UsageError(
            f"{str(arguments.reference)!r} is floating and does not say what white is; pass --data-range, "
            "1.0 if white is 1"
        )
    limits = np.iinfo(dtype)
    return float(limits.max) - float(limits.min)


def _evaluate(reference: "Picture", image: "Picture", data_range: float) -> dict[str, float]:
    import jax

    from jaxlens.metrics import evaluate_in_strips

    # Sums over millions of pixels are good to all digits shown in double precision only.
    with jax.enable_x64(True), progress_of("comparing") as progress:
        scores = evaluate_in_strips(reference.pixels, image.pixels, data_range=data_range, progress=progress)
        return {name: float(score) for name, score in scores.items()}


def _print_json(arguments: Arguments, picture: "Picture", data_range: float, scores: dict[str, float]) -> None:
    pixels = picture.pixels
    record = {
        "reference": str(arguments.reference),
        "image": str(arguments.image),
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "channels": pixels.shape[2] if pixels.ndim == 3 else 1,
        "dtype": pixels.dtype.name,
        "data_range": data_range,
        "metrics": {name: _json_number(score) for name, score in scores.items()},
    }
    print(json.dumps(record, indent=2, allow_nan=False))  # noqa: T201


def _json_number(value: float) -> float | str:
    # As in the JSON mapping of protocol buffers; Python's float() and JavaScript's Number() read them.
    if math.isnan(value):
        return "NaN"
    return value if math.isfinite(value) else ("Infinity" if value > 0 else "-Infinity")


def _print_table(arguments: Arguments, picture: "Picture", data_range: float, scores: dict[str, float]) -> None:
    from rich.console import Console
    from rich.table import Table

    from jaxlens.metrics import METRICS

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("metric")
    table.add_column("value", justify="right")
    table.add_column("unit")
    table.add_column("meaning")
    for name, score in scores.items():
        table.add_row(name, f"{score:.6g}", METRICS[name].unit, METRICS[name].meaning)
    console = Console(markup=False, highlight=False, soft_wrap=True)
    # Captured, for rich would end the process by itself where the reader has stopped reading.
    with console.capture() as text:
        console.print(f"{str(arguments.image)!r} against {str(arguments.reference)!r}")
        console.print(f"{describe(picture)}, data range {data_range:g}\n")
        console.print(table)
    print(text.get(), end="")  # noqa: T201
