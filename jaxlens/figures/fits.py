"""Fits, drawn: what is left over, the curve of the lens, and how well both are known."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxlens.figures.palette import BLUE, FAINT, MUTED, VERMILLION, WIDTH
from jaxlens.figures.style import new_figure, plain, show_image, style
from jaxlens.fitting import Fit, distortion_curve
from jaxlens.warping import distort_image, undistort_image

# Arrows and dots beyond which a figure shows a sample.
_MOST = 2000
# Half the width of a 95 % interval, in standard errors.
_NORMAL_95 = 1.96
# The longest arrow is about so long, as a share of the picture's longer side.
_ARROW = 0.08
# Points along the longer side of a map.
_MAP = 96


def residual_figure(points: np.ndarray, residuals: np.ndarray, fit: Fit, unit: str) -> Figure:
    """Draws residuals as arrows where the points were seen, and their lengths against the radius.

    Args:
        points: `(N, 2)` observed points.
        residuals: `(N, 2)` observed − predicted.
        fit: The fit, for its frame's centre and its RMS.
        unit: Unit of both.
    """
    with style():
        shown = _sample(len(points))
        points, residuals = points[shown], residuals[shown]
        length = np.hypot(*residuals.T)
        figure = new_figure(WIDTH, 3.6)
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
        span = max(float(np.ptp(points, axis=0).max()), 1e-12)
        longest = max(float(np.percentile(length, 98)), 1e-300)
        factor = _ARROW * span / longest
        left.quiver(
            *points.T,
            *(residuals * factor).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            color=BLUE,
            width=0.003,
            headwidth=4,
        )
        left.plot(*points.T, ".", color=MUTED, markersize=1.5)
        left.set_title(f"residuals, arrows × {factor:.3g}", loc="left")
        _as_picture(left, unit)
        radius = np.hypot(*(points - _center(fit)).T)
        right.plot(radius, length, ".", color=BLUE, markersize=4, markeredgewidth=0, alpha=0.6)
        right.axhline(float(fit.rms), color=VERMILLION, linewidth=1.2, label=f"RMS {float(fit.rms):.3g}")
        right.set_title("residual against radius", loc="left")
        right.set_xlabel(f"distance from the centre [{unit}]")
        right.set_ylabel(f"length of the residual [{unit}]")
        right.set_ylim(bottom=0)
        right.legend(loc="upper left")
        right.grid(axis="y")
        return figure


def lines_figure(lines: Sequence[np.ndarray], residuals: np.ndarray, fit: Fit, unit: str) -> Figure:
    """Draws points on lines as they were seen and how far they are from straight, and that against the radius.

    Args:
        lines: Observed points, `(n, 2)` a line.
        residuals: `(L, N, 1)` as of `fit_lines`.
        fit: The fit.
        unit: Unit of both.
    """
    with style():
        figure = new_figure(WIDTH, 3.6)
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
        points = np.concatenate(list(lines))
        distances = np.concatenate([residuals[i, : len(line), 0] for i, line in enumerate(lines)])
        for line in lines:
            left.plot(*line.T, "-", color=FAINT, linewidth=0.8, zorder=0)
        limit = max(float(np.percentile(np.abs(distances), 99)), 1e-300)
        dots = left.scatter(*points.T, c=distances, s=5, cmap="PuOr", vmin=-limit, vmax=limit, linewidths=0)
        bar = figure.colorbar(dots, ax=left, shrink=0.8, pad=0.02)
        bar.set_label(f"distance from the line [{unit}]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        left.set_title("points, as seen", loc="left")
        _as_picture(left, unit)
        shown = _sample(len(points))
        radius = np.hypot(*(points[shown] - _center(fit)).T)
        right.plot(radius, distances[shown], ".", color=BLUE, markersize=4, markeredgewidth=0, alpha=0.6)
        right.axhline(0, color=MUTED, linewidth=0.8)
        right.set_title(f"RMS {float(fit.rms):.3g} {unit}", loc="left")
        right.set_xlabel(f"distance from the centre [{unit}]")
        right.set_ylabel(f"distance from the line [{unit}]")
        right.grid(axis="y")
        return figure


def curve_figure(fit: Fit, ideal: np.ndarray, unit: str) -> Figure:
    """Draws how far the lens moves points, along the radius, with a 95 % band.

    Args:
        fit: The fit.
        ideal: `(N, 2)` ideal points, normalized; the curve ends at the farthest, and they are marked below it.
        unit: What the frame's scale turns normalized lengths into.
    """
    with style():
        figure = new_figure(WIDTH, 4.4)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        reach = np.hypot(*np.asarray(ideal).T)
        radii = np.linspace(0, float(reach.max()), 200)
        moved, error = (np.asarray(part) for part in distortion_curve(fit, jnp.asarray(radii)))
        size = 1.0 if fit.frame is None else float(fit.frame.scale[0])
        known = bool(np.isfinite(error).all())
        half = size * _NORMAL_95 * (error if known else np.zeros_like(error))
        upper.axhline(0, color=MUTED, linewidth=0.8)
        upper.fill_between(size * radii, size * moved - half, size * moved + half, color=BLUE, alpha=0.25, linewidth=0)
        upper.plot(size * radii, size * moved, color=BLUE)
        marks = size * reach[_sample(len(reach))]
        upper.plot(marks, np.zeros_like(marks), "|", color=MUTED, markersize=6)
        upper.set_title(f"{type(fit.lens).__name__}: how far points are moved, towards +x", loc="left")
        upper.set_ylabel(f"moved outwards [{unit}]")
        upper.grid(axis="y")
        if known:
            lower.fill_between(size * radii, -half, half, color=BLUE, alpha=0.25, linewidth=0)
        lower.axhline(0, color=BLUE)
        lower.set_title("its 95 % band, enlarged" if known else "its uncertainty is unknown", loc="left")
        lower.set_ylabel(f"± [{unit}]")
        lower.set_xlabel(f"ideal radius [{unit}]")
        lower.grid(axis="y")
        return figure


def views_figure(names: Sequence[str], rms: np.ndarray) -> Figure:
    """Draws the RMS of each view as a bar."""
    with style():
        figure = new_figure(WIDTH, max(1.6, 0.45 + 0.21 * len(names)))
        axes = figure.subplots()
        places = np.arange(len(names))
        axes.barh(places, rms, color=BLUE, height=0.65)
        axes.axvline(float(np.median(rms)), color=VERMILLION, linewidth=1.2, label=f"median {np.median(rms):.3g}")
        axes.set_yticks(places, [plain(name) for name in names])
        axes.invert_yaxis()
        axes.set_title("RMS distance of each view", loc="left")
        axes.set_xlabel("pixels")
        axes.grid(axis="x")
        axes.set_axisbelow(True)
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
        return figure


def uncertainty_figure(fit: Fit, observed: np.ndarray) -> Figure:
    """Draws how well a calibrated camera is known over its picture, and where corners were seen.

    Args:
        fit: As `calibrate` returns it.
        observed: `(N, 2)` the corners in pixels.
    """
    with style():
        width, height = (float(length) for length in np.asarray(fit.image_size))
        long = max(width, height)
        x, y = (np.linspace(0, side - 1, max(2, round(_MAP * side / long))) for side in (width, height))
        known = np.asarray(fit.projection_uncertainty(np.stack(np.meshgrid(x, y), axis=-1)))
        figure = new_figure(WIDTH, WIDTH * 0.8 * height / width + 0.6)
        axes = figure.subplots()
        shown = axes.imshow(
            np.ma.masked_invalid(known), cmap="viridis", extent=(0, width - 1, height - 1, 0), interpolation="nearest"
        )
        if np.isfinite(known).sum() > 3:
            lines = axes.contour(x, y, np.ma.masked_invalid(known), colors="white", linewidths=0.8)
            axes.clabel(lines, fmt="%.2g", fontsize=8)
        axes.plot(*observed[_sample(len(observed))].T, ".", color="white", markersize=1.5, alpha=0.6)
        axes.set_title("one standard deviation of where a ray is seen; dots are corners", loc="left")
        axes.set_xlim(0, width - 1)
        axes.set_ylim(height - 1, 0)
        axes.set_xlabel("x [pixels]")
        axes.set_ylabel("y [pixels]")
        bar = figure.colorbar(shown, ax=axes, shrink=0.85, pad=0.02)
        bar.set_label("pixels")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        return figure


def pictures_figure(fit: Fit, source: ArrayLike, distorted: ArrayLike) -> Figure:
    """Draws a pair of pictures, what the fitted lens makes of each, and what is left between them.

    Args:
        fit: As `fit_images` returns it.
        source: `(H, W)` or `(H, W, C)`, the picture without the lens.
        distorted: The picture with it, of the same size.
    """
    with style():
        first, second = (_gray(np.asarray(image, np.float64)) for image in (source, distorted))
        gain, offset = (float(fit.parameters[name]) for name in ("gain", "offset"))
        made = np.asarray(distort_image(jnp.asarray(first), fit.lens, frame=fit.frame, fill=jnp.nan))
        undone = np.asarray(undistort_image(jnp.asarray(second), fit.lens, frame=fit.frame, fill=jnp.nan))
        left_over = np.asarray(fit.residuals)[..., 0]
        limit = max(float(np.percentile(np.abs(left_over), 99.5)), 1e-9)
        peak = max(first.max(), second.max(), 1e-12)
        figure = new_figure(WIDTH, 5.0 * first.shape[0] / first.shape[1] + 0.5)
        places = figure.subplots(2, 3)
        show_image(places[0, 0], first, peak, title="source")
        show_image(places[0, 1], np.nan_to_num(gain * made + offset), peak, title="source through the lens")
        show_image(places[0, 2], second, peak, title="distorted, as given")
        show_image(places[1, 0], np.nan_to_num((undone - offset) / gain), peak, title="distorted, undistorted")
        shown = places[1, 1].imshow(left_over, cmap="PuOr", vmin=-limit, vmax=limit, interpolation="antialiased")
        places[1, 1].set_title(f"left over, RMS {float(fit.rms):.3g}", pad=4)
        places[1, 1].set_xticks([])
        places[1, 1].set_yticks([])
        bar = figure.colorbar(shown, ax=places[1, 1], shrink=0.85, pad=0.03)
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        places[1, 2].hist(left_over[left_over != 0], bins=61, range=(-limit, limit), color=BLUE)
        places[1, 2].set_title("left over, gray levels", pad=4)
        places[1, 2].set_yticks([])
        return figure


def _as_picture(axes: Axes, unit: str) -> None:
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")


def _center(fit: Fit) -> np.ndarray:
    return np.zeros(2) if fit.frame is None else np.asarray(fit.frame.center)


def _gray(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 2 else image.mean(axis=-1)


def _sample(count: int) -> np.ndarray:
    """Indices of at most so many points as a figure can show, evenly spread; the same every time."""
    return np.arange(count) if count <= _MOST else np.linspace(0, count - 1, _MOST).round().astype(int)
