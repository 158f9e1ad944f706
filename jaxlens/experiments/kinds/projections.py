"""Figure 5: integral projections of an image under barrel and pincushion distortion, and how far they moved."""

from pathlib import Path

import numpy as np
from pydantic import Field, model_validator
from rich.console import Console

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.errors import ConfigError
from jaxlens.experiments.experiment import Experiment
from jaxlens.experiments.outcome import Outcome
from jaxlens.experiments.projecting import AXES, Axis, Profile, distorted, profiles
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.schema import Image, Warp
from jaxlens.experiments.sources import load_source
from jaxlens.experiments.tables import Value, write_csv
from jaxlens.figures.projections import displacement_chart, projection_panel
from jaxlens.figures.style import save


class ProjectionsExperiment(Experiment):
    """Integral projections of an image and of what one-parameter lenses make of it: Figure 5.

    Attributes:
        image: The image.
        k: Coefficients of Section 2.4, where 1 + k r² takes output to source: k > 0 is barrel.
        window: Length of the pieces of a projection that are compared, in pixels, odd.
        largest: The largest displacement that is looked for, in pixels.
        least_score: Correlation of two pieces below which they do not count as the same.
        warp: How the image is sampled.
    """

    image: Image
    k: list[float] = Field(default=[0.3, -0.3], min_length=1, max_length=3)
    window: int = Field(default=31, ge=3)
    largest: int = Field(default=16, ge=1)
    least_score: float = Field(default=0.9, ge=-1, le=1)
    warp: Warp = Warp()

    @model_validator(mode="after")
    def _check(self) -> "ProjectionsExperiment":
        if self.window % 2 == 0:
            raise ValueError(f"'window' must be odd, got {self.window}")
        if len(set(self.k)) < len(self.k):
            raise ValueError("'k' must hold each coefficient once")
        return self

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment."""
        return perform_projections(configuration, self, folder)


_HEADER = (
    "k",
    "distortion",
    "profile",
    "largest_change",
    "measured",
    "least_px",
    "most_px",
    "median_error_px",
    "within_2_px",
)
# Of the expected displacement, in pixels: what counts as near.
_NEAR = 2.0
_MEANS = {"x": "columns", "y": "rows"}


def perform_projections(configuration: Configuration, experiment: ProjectionsExperiment, folder: Path) -> Outcome:
    """Carries out the experiment: `table.csv` sums up, `profiles_x.csv` and `profiles_y.csv` hold every element.

    Raises:
        ConfigError: the image is too small for the window or the displacements.
    """
    source = load_source(configuration, experiment.image)
    pixels = source.pixels if source.pixels.ndim == 2 else source.pixels.mean(axis=-1)
    shorter = min(pixels.shape)
    if experiment.window > shorter or experiment.largest >= shorter - 2:
        raise ConfigError(
            f"{configuration.path}: window and largest: got {experiment.window} and {experiment.largest}; the image "
            f"has only {pixels.shape[0]} rows and {pixels.shape[1]} columns"
        )
    pictures, found = {}, {}
    for k in experiment.k:
        pictures[k], seen = distorted(pixels, k, experiment.warp)
        found[k] = profiles(
            pixels,
            pictures[k],
            seen,
            k,
            window=experiment.window,
            largest=experiment.largest,
            least_score=experiment.least_score,
        )
    columns: dict[str, list[Value]] = {name: [] for name in _HEADER}
    rows: list[list[str]] = []
    for k, both in found.items():
        for axis, profile in both.items():
            row = (k, kind_of(k), axis, *_summary(profile))
            for name, value in zip(_HEADER, row, strict=True):
                columns[name].append(value)
            change, measured, least, most, error, near = row[3:]
            rows.append(
                [
                    f"{k:+g} {kind_of(k)}",
                    _MEANS[axis],
                    f"{change:.1f}",
                    f"{100 * measured:.0f} %",
                    f"{least:+.1f} … {most:+.1f}",
                    f"{error:.2f}",
                    f"{100 * near:.0f} %",
                ]
            )
    write_csv(folder, columns)
    for axis in AXES:
        write_csv(folder, _elements(axis, found), f"profiles_{axis}.csv")
    names = {k: f"k = {k:+g}: {kind_of(k)}".replace("-", "−") for k in experiment.k}
    save(projection_panel(pixels, source.peak, pictures, found, names), folder, "projections")
    save(displacement_chart(found, names), folder, "displacement", vector=True)
    header = ["k", "means", "largest\nchange", "found", "displacement\npx", "median\nerror, px", "within\n2 px"]
    return Outcome([source.facts], {}, [plain_table(experiment.title or experiment.name, header, rows)])


def kind_of(k: float) -> str:
    """Returns what Section 2.4 calls a coefficient."""
    return "none" if k == 0 else "barrel" if k > 0 else "pincushion"


def _summary(profile: Profile) -> tuple[float, ...]:
    seen, error = np.isfinite(profile.measured), np.abs(profile.error)
    change = float(np.nanmax(np.abs(profile.distorted - profile.initial)))
    if not len(error):
        return change, 0.0, *[np.nan] * 4
    moved = profile.measured[seen]
    return (
        change,
        float(seen.mean()),
        float(moved.min()),
        float(moved.max()),
        float(np.median(error)),
        float(np.mean(error <= _NEAR)),
    )


def _elements(axis: Axis, found: dict[float, dict[Axis, Profile]]) -> dict[str, np.ndarray]:
    first = next(iter(found.values()))[axis]
    columns: dict[str, np.ndarray] = {axis: np.arange(len(first.initial)), "initial": first.initial}
    for k, both in found.items():
        profile = both[axis]
        columns |= {
            f"k={k:g}": profile.distorted,
            f"measured(k={k:g})": profile.measured,
            f"expected(k={k:g})": profile.expected,
        }
    return columns
