"""A camera calibrated with several lenses, and each judged on views that it has not seen."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from rich.console import Console, RenderableType

import jaxlens as jl
from jaxlens import figures
from jaxlens.experiments import (
    Configuration,
    Experiment,
    ExperimentError,
    InputFile,
    Outcome,
    Table,
    Value,
    plain_table,
    progress_bar,
    write_rows,
)
from jaxlens.files import file_sha256


class BoardModel(Table):
    """A lens to calibrate with.

    Attributes:
        name: What the table calls it.
        terms: Coefficients of the Brown–Conrady lens: 4, 5 or 8.
        fixed: Parameters that stay zero.
        reference_rms: The RMS that other software reports on the same corners, if known.
    """

    name: str
    terms: Literal[4, 5, 8]
    fixed: list[str] = Field(default=[])
    reference_rms: float | None = None


class BoardsExperiment(Experiment):
    """A camera calibrated from corners of a board, with several lenses, and tried on views held out.

    Attributes:
        corners: A CSV file of corners, relative to the configuration (see `jaxlens calibrate --corners`).
        image_size: Width and height of the pictures.
        models: The lenses.
        held_out: Every so manieth view is held out, in turn, to be judged by the others.
    """

    corners: Annotated[str, InputFile("CSV file")]
    image_size: Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=2, max_length=2)]
    models: list[BoardModel] = Field(min_length=1, max_length=7)
    held_out: int = Field(default=4, ge=2)

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: `table.csv` has every parameter, `models.csv` what is left over.

        Raises:
            ExperimentError: the corners cannot be read.
        """
        path = configuration.file(self.corners)
        try:
            names, views = jl.calibrations.read_corners(path)
        except jl.calibrations.CalibrationError as error:
            raise ExperimentError(str(error)) from error
        boards = jl.fitting.Boards.from_views(views)
        width, height = self.image_size
        table: list[tuple[Value, ...]] = []
        models: list[tuple[Value, ...]] = []
        fits: list[jl.fitting.Fit] = []
        with progress_bar(progress, self.name, len(self.models)) as advance:
            for model in self.models:
                fit = _calibrate(model, boards, (width, height), np.ones(len(views), bool))
                fits.append(fit)
                errors = np.asarray(fit.standard_errors)
                for name, value, error in zip(fit.names, np.asarray(fit.values), errors, strict=True):
                    table.append((model.name, name, value, error))
                weak = [name for name, flag in zip(fit.names, np.asarray(fit.unidentified), strict=True) if flag]
                reference = np.nan if model.reference_rms is None else model.reference_rms
                held_out = _held_out(model, boards, (width, height), self.held_out)
                folds = "yes" if bool(fit.folds) else "no"
                models.append((model.name, float(fit.rms), reference, held_out, " ".join(weak) or "none", folds))
                advance(1)
        write_rows(folder, ("model", "parameter", "estimate", "standard_error"), table)
        header = ("model", "rms", "reference_rms", "held_out_rms", "not_identified", "folds")
        write_rows(folder, header, models, "models.csv")
        _draw(fits[0], boards, names, folder)
        facts = {"file": path.name, "sha256": file_sha256(path), "views": len(views)}
        return Outcome([facts], {}, _report(self, fits, models))


def _calibrate(
    model: BoardModel, boards: jl.fitting.Boards, size: tuple[int, int], views: np.ndarray
) -> jl.fitting.Fit:
    """A calibration from some of the views.

    Raises:
        ExperimentError: it did not converge, or the views do not determine it.
    """
    import jax

    fit = jax.jit(_fit, static_argnames=("terms", "fixed", "size"))(
        _only(boards, views), terms=model.terms, fixed=tuple(model.fixed), size=size
    )
    if int(fit.status) != jl.fitting.FitStatus.CONVERGED:
        reason = jl.fitting.FitStatus(int(fit.status)).name.lower().replace("_", " ")
        raise ExperimentError(f"model {model.name!r}, {views.sum()} of {views.size} views: {reason}")
    return fit


def _fit(boards: jl.fitting.Boards, *, terms: int, fixed: tuple[str, ...], size: tuple[int, int]) -> jl.fitting.Fit:
    return jl.fitting.calibrate(jl.BrownConrady([0.0] * terms), boards, size, fixed=fixed, throw=False)


def _only(boards: jl.fitting.Boards, views: np.ndarray) -> jl.fitting.Boards:
    """The boards with no weight on the other views: whichever are left out, it is one program."""
    import equinox as eqx

    return eqx.tree_at(lambda boards: boards.weights, boards, np.where(views[:, None], boards.weights, 0))


def _held_out(model: BoardModel, boards: jl.fitting.Boards, size: tuple[int, int], every: int) -> float:
    """The RMS over all views, each judged by a calibration without it and those held out with it."""
    turns = np.arange(boards.observed.shape[0]) % every
    squares = count = 0.0
    for turn in np.unique(turns):
        out = turns == turn
        fit = _calibrate(model, boards, size, ~out)
        assert fit.frame is not None
        judged = jl.fitting.validate(fit.lens, fit.frame, _only(boards, out))
        seen = float(np.sum(np.asarray(boards.weights)[out]))
        squares, count = squares + float(judged.rms) ** 2 * seen, count + seen
    return float(np.sqrt(squares / count))


def _draw(fit: jl.fitting.Fit, boards: jl.fitting.Boards, names: list[str], folder: Path) -> None:
    assert fit.frame is not None
    seen = np.asarray(boards.weights) > 0
    observed = np.asarray(boards.observed)[seen]
    ideal = np.asarray(fit.lens.invert(fit.frame.normalize(observed)).points)
    figures.save(
        figures.residual_figure(observed, np.asarray(fit.residuals)[seen], fit, "pixels"), folder / "residuals.png"
    )
    figures.save(figures.curve_figure(fit, ideal, "pixels"), folder / "curve.svg")
    figures.save(figures.views_figure(names, np.asarray(fit.per_view_rms)), folder / "views.svg")


def _report(
    experiment: BoardsExperiment, fits: list[jl.fitting.Fit], models: list[tuple[Value, ...]]
) -> list[RenderableType]:
    header = ["model", "RMS, px", "elsewhere", "held out, px", "not identified", "folds in the picture"]
    rows = [
        [f"{cell:.7f}" if isinstance(cell, float) and np.isfinite(cell) else str(cell) for cell in row]
        for row in models
    ]
    parameters = [
        [name, *("" if name not in fit.names else _estimate(fit, name) for fit in fits)]
        for name in max((fit.names for fit in fits), key=len)
    ]
    return [
        plain_table(experiment.heading, header, rows),
        plain_table("Estimates ± standard errors", ["", *(model.name for model in experiment.models)], parameters),
    ]


def _estimate(fit: jl.fitting.Fit, name: str) -> str:
    index = fit.names.index(name)
    return f"{float(fit.values[index]):.5g} ± {float(fit.standard_errors[index]):.2g}"
