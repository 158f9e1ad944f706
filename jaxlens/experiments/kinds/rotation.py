"""The conclusion's remark: pincushion distortion makes self-calibration under-estimate the focal length."""

from pathlib import Path

import numpy as np
from rich.console import Console, RenderableType
from rich.text import Text

from jaxlens.experiments.kinds.outcome import Outcome, progress_bar
from jaxlens.experiments.reports import plain_table
from jaxlens.experiments.rotating import Biases, focal_length_biases
from jaxlens.experiments.schema import RotationExperiment
from jaxlens.experiments.tables import write_csv
from jaxlens.figures.rotations import bias_chart
from jaxlens.figures.style import save


def perform_rotation(experiment: RotationExperiment, folder: Path, progress: Console) -> Outcome:
    """Carries out the experiment: a row of `table.csv` is a set of rotations and a lens."""
    with progress_bar(progress, experiment.name, 1) as advance:
        found = focal_length_biases(experiment)
        advance(1)
    k = np.asarray(experiment.k)
    write_csv(
        folder,
        {
            "rotations": [one.name for one in found for _ in k],
            "k": [value for _ in found for value in k],
            "bias": np.concatenate([one.raw for one in found]),
            "bias_lens_known": np.concatenate([one.known for one in found]),
            "rms_bias_lens_fitted": np.concatenate([one.fitted_rms for one in found]),
        },
    )
    save(bias_chart(experiment.k, found, experiment.noise), folder / "bias.svg")
    return Outcome([], _facts(k, found), _report(experiment, k, found))


def _facts(k: np.ndarray, found: list[Biases]) -> dict[str, object]:
    return {
        "short_for_every_pincushion": all(bool(np.all(one.raw[k > 0] < 0)) for one in found),
        "long_for_every_barrel": all(bool(np.all(one.raw[k < 0] > 0)) for one in found),
        "grows_with_the_lens": all(_grows(one.raw) for one in found),
        "largest_bias_lens_known": max(float(np.max(np.abs(one.known))) for one in found),
        "largest_rms_bias_lens_fitted": max(float(np.max(one.fitted_rms)) for one in found),
        "without_a_focal_length": sum(int(np.sum(np.isinf(one.raw))) for one in found),
    }


def _grows(bias: np.ndarray) -> bool:
    """Whether the bias falls from one lens to the next: away from k = 0 its size grows to both sides."""
    finite = bias[np.isfinite(bias)]
    # No focal length at all is the end of the growth: such lenses come first.
    ends_first = bool(np.all(np.isinf(bias[: len(bias) - len(finite)])))
    return ends_first and bool(np.all(np.diff(finite) < 0))


def _report(experiment: RotationExperiment, k: np.ndarray, found: list[Biases]) -> list[RenderableType]:
    shown = np.unique(np.linspace(0, len(k) - 1, min(len(k), 8)).round().astype(int))
    header = ["bias, %, by k", *(f"{k[index]:+.3g}" for index in shown)]
    rows = [[one.name, *(f"{100 * one.raw[index]:+.1f}" for index in shown)] for one in found]
    facts = _facts(k, found)
    verdict = [
        ("too short for every pincushion (k > 0)", facts["short_for_every_pincushion"]),
        ("too long for every barrel (k < 0)", facts["long_for_every_barrel"]),
        ("the more so the stronger the lens", facts["grows_with_the_lens"]),
    ]
    lines = [f"{text}: {'yes' if holds else 'no'}" for text, holds in verdict]
    return [
        plain_table(experiment.title or experiment.name, header, rows),
        Text(
            "; ".join(lines)
            + f".\nUndistorted with the lens itself, a bias of at most {facts['largest_bias_lens_known']:.1e} is left; "
            f"with a lens fitted to {experiment.points} points ± {experiment.noise:g} half diagonals, at most "
            f"{100 * float(str(facts['largest_rms_bias_lens_fitted'])):.2f} % (RMS)."
        ),
    ]
