"""All preimages of a map of the plane, by brute force, from nothing but its equation in NumPy."""

import numpy as np


def check_against_a_search(equation, observed, points, valid, *, reach=2.4):
    """Asserts that points are valid exactly where one of all preimages lies in the map's region about the origin.

    Newton's iteration from a dense grid of starts finds them. Next to the region's edge either answer is right.

    Args:
        equation: Takes complex points (2, …) to points (2, …).
        observed: (N, 2), what the points are preimages of.
        points: (N, 2), what is to be checked.
        valid: (N,), likewise.
        reach: Up to where preimages are looked for.
    """
    observed, points, valid = np.asarray(observed).T, np.asarray(points).T, np.asarray(valid)
    with np.errstate(all="ignore"):
        value, _ = _linearized(equation, points)
        assert np.max(np.abs(value - observed)[:, valid], initial=0) < 1e-12
        inside, determinant = _lies_inside(equation, points)
        assert (inside | (np.abs(determinant) < 1e-3))[valid].all()
        starts = np.stack(np.meshgrid(*[np.linspace(-reach, reach, 13)] * 2)).reshape(2, 1, -1)
        root = np.broadcast_to(starts, (2, observed.shape[1], starts.shape[-1]))
        for _ in range(30):
            value, ((a, b), (c, d)) = _linearized(equation, root)
            u, v = value - observed[..., None]
            step = np.stack([d * u - b * v, a * v - c * u]) / (a * d - b * c)
            root = root - np.clip(np.nan_to_num(step), -0.3, 0.3)
        value, _ = _linearized(equation, root)
        owner, _ = found = np.nonzero(np.max(np.abs(value - observed[..., None]), axis=0) < 1e-12)
        owner, *preimages = np.unique(np.round([owner, *root[:, *found]], 10), axis=1)
        inside, determinant = _lies_inside(equation, np.array(preimages))
    assert valid[owner[inside & (determinant > 1e-3)].astype(int)].all()


def _linearized(equation, points):
    """Values and Jacobians (row: output), by complex steps."""
    columns = []
    for axis in range(2):
        moved = points.astype(complex)
        moved[axis] += 1e-30j
        value = equation(moved)
        columns.append(value.imag / 1e-30)
    return value.real, np.stack(columns, axis=1)


def _lies_inside(equation, points):
    """Whether points (2, N) lie before the first fold or pole on their ray, followed in small steps."""
    share = np.linspace(0, 1, 2001)[:, None]
    _, ((a, b), (c, d)) = _linearized(equation, points[:, None] * share)
    determinant = a * d - b * c
    return np.all(determinant > 0, axis=0), determinant[-1]
