"""Pictures and folders for the tests of pictures and of the command line."""

from pathlib import Path

import numpy as np


def smooth(dtype=np.uint8, channels=3, height=24, width=32):
    """A picture without noise, and bright: nothing in it is the fill value."""
    y, x = np.mgrid[:height, :width]
    planes = np.stack([0.4 + 0.5 * np.sin(0.2 * x + 0.3 * y + plane) ** 2 for plane in range(channels)], axis=-1)
    full = 1 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    pixels = (planes * full).astype(dtype)
    if channels in (2, 4):
        pixels[..., -1] = full
    return pixels[..., 0] if channels == 1 else pixels


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in Path(folder).rglob("*") if path.is_file())
