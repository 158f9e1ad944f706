"""Triangles onto pixels: which ones they cover, and the largest value there (a z-buffer), in NumPy."""

from collections.abc import Iterator

import numpy as np

# Bits after the point of a pixel coordinate, and in all: the difference of two products of differences fits 64 bits.
_FRACTION, _BITS = 16, 29
# Rows or pixels worked on at a time, and pixels in all triangles' boxes together: a few minutes.
_CHUNK = 2**20
_MOST = 2**32


def rasterize(points: np.ndarray, values: np.ndarray, faces: np.ndarray, height: int, width: int) -> np.ndarray:
    """Returns the first of what `rasterize_faces` does."""
    return rasterize_faces(points, values, faces, height, width)[0]


def rasterize_faces(
    points: np.ndarray, values: np.ndarray, faces: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Finds at each pixel the largest value among the triangles that cover its centre, and the triangle.

    Coverage is decided in whole numbers, for vertices rounded to 2⁻¹⁶ of a pixel (coarser where triangles reach
    more than 2¹³ pixels away), edges included: triangles that share an edge leave no pixel between them uncovered.
    Values are those of the plane through the vertices as they are.

    Args:
        points: `(V, 2)` pixel coordinates (x, y) of the vertices, pixel centres at integers.
        values: `(V,)` at the vertices, linear between them.
        faces: `(F, 3)` vertices of the triangles. Those without area are ignored.
        height: Height of the picture.
        width: Width of the picture.

    Returns:
        `(height, width)`, −∞ where there is no triangle; and the triangle's row in `faces`, −1 where there is none.

    Raises:
        ValueError: triangles that reach too far, or so many large ones that it would take minutes.
    """
    buffer, owner = np.full(height * width, -np.inf), np.full(height * width, -1)
    size = np.array([width, height])
    low, high = _box(points, faces)
    seen = ((high >= -0.5) & (low <= size - 0.5)).all(axis=1)
    if not seen.any():
        return buffer.reshape(height, width), owner.reshape(height, width)
    numbers, faces = np.flatnonzero(seen), faces[seen]
    farthest = float(np.maximum(np.abs(low[seen]), np.abs(high[seen])).max())
    fraction = min(_FRACTION, _BITS - 1 - int(np.ceil(np.log2(farthest + 1))))
    if fraction < 0:
        raise ValueError(
            f"triangles in the picture reach {farthest:.3g} pixels away from its corner; use a larger spacing"
        )
    snapped = np.rint(points * 2.0**fraction).astype(np.int64)
    low, high = _box(snapped, faces)
    first, last = np.maximum(-(-low >> fraction), 0), np.minimum(high >> fraction, size - 1)
    used = (first <= last).all(axis=1)  # most triangles of a fine mesh lie between the pixels' centres
    numbers, faces, first, last = numbers[used], faces[used], first[used], last[used]
    origin = snapped[faces[:, 0]]
    double_area = _cross(snapped[faces[:, 1]] - origin, snapped[faces[:, 2]] - origin)
    # The same sense of rotation for all, so that inside is where no edge function is negative.
    faces = np.where(double_area[:, None] < 0, faces[:, [0, 2, 1]], faces)
    used = double_area != 0
    numbers, faces, first, last = numbers[used], faces[used], first[used], last[used]
    boxes = np.prod(last - first + 1, axis=1, dtype=np.float64).sum()
    if boxes > _MOST:
        raise ValueError(
            f"the triangles cover the picture {boxes / buffer.size:.3g} times over; make the picture smaller, or show "
            "more of the mesh"
        )
    plane = _planes(points[faces], values[faces])
    for some in _chunks(last[:, 1] - first[:, 1] + 1):
        parts = [part[some] for part in plane]
        _draw(buffer, owner, width, snapped[faces[some]], fraction, first[some], last[some], parts, numbers[some])
    return buffer.reshape(height, width), owner.reshape(height, width)


def _draw(
    buffer: np.ndarray,
    owner: np.ndarray,
    width: int,
    corners: np.ndarray,
    fraction: int,
    first: np.ndarray,
    last: np.ndarray,
    plane: list[np.ndarray],
    numbers: np.ndarray,
) -> None:
    """Cuts triangles into rows, rows into pixels, and keeps the largest values and whose they are."""
    face, step = expanded(last[:, 1] - first[:, 1] + 1)
    begin, end = np.zeros_like(face), (last - first)[face, 0]
    relative = corners - (first << fraction)[:, None]  # from the first pixel of the box, so that nothing overflows
    for corner in range(3):
        start, edge = relative[:, corner], relative[:, (corner + 1) % 3] - relative[:, corner]
        # edge × (pixel − start) ≥ 0 along a row, that is constant + slope · column ≥ 0
        slope = (-edge[:, 1] << fraction)[face]
        constant = (edge[:, 1] * start[:, 0] - edge[:, 0] * start[:, 1])[face] + edge[face, 0] * (step << fraction)
        divisor = np.where(slope == 0, 1, np.abs(slope))
        begin = np.where(slope > 0, np.maximum(begin, -(constant // divisor)), begin)
        end = np.where(slope < 0, np.minimum(end, constant // divisor), end)
        end = np.where((slope == 0) & (constant < 0), -1, end)
    full = begin <= end
    face, step, begin, end = face[full], step[full], begin[full], end[full]
    base, slope_x, slope_y, origin_x, origin_y, smallest, largest = plane
    column, row = begin + first[face, 0], step + first[face, 1]
    for some in _chunks(end - begin + 1):
        line, offset = expanded((end - begin + 1)[some])
        of_face = face[some][line]
        x, y = column[some][line] + offset, row[some][line]
        value = base[of_face] + slope_x[of_face] * (x - origin_x[of_face]) + slope_y[of_face] * (y - origin_y[of_face])
        # Slivers have wild slopes; rounded edges reach a little beyond the triangle.
        pixel, value = y * width + x, np.clip(value, smallest[of_face], largest[of_face])
        np.maximum.at(buffer, pixel, value)
        largest_yet = value == buffer[pixel]
        owner[pixel[largest_yet]] = numbers[of_face[largest_yet]]


def _planes(corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Returns base value, slopes along x and y, the base's x and y, and the smallest and largest value of triangles."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    rise_1, rise_2 = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
    area = _cross(first, second)
    area = np.where(area == 0, np.inf, area)
    slope_x = (rise_1 * second[:, 1] - rise_2 * first[:, 1]) / area
    slope_y = (rise_2 * first[:, 0] - rise_1 * second[:, 0]) / area
    smallest, largest = values.min(axis=1), values.max(axis=1)
    return values[:, 0], slope_x, slope_y, corners[:, 0, 0], corners[:, 0, 1], smallest, largest


def _box(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the smallest and largest coordinates of triangles; NumPy's reduction over three is slow."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def expanded(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns, for counts (2, 3), the owners (0, 0, 1, 1, 1) and the places (0, 1, 0, 1, 2)."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def _chunks(counts: np.ndarray) -> Iterator[slice]:
    """Yields slices whose counts add up to about `_CHUNK`, one element at least."""
    ends = np.cumsum(counts)
    begin, done = 0, 0
    while begin < len(counts):
        end = max(begin + 1, int(np.searchsorted(ends, done + _CHUNK, side="right")))
        yield slice(begin, end)
        begin, done = end, int(ends[end - 1])
