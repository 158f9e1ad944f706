"""A fisheye calibrated with several lenses from boards that it bends, and each judged on other views."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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

View = tuple[np.ndarray, np.ndarray]


class FisheyeModel(Table):
    """A lens to calibrate with.

    Attributes:
        name: What the table calls it.
        lens: Its name in files, as `jaxlens calibrate --model` takes it.
        terms: How many coefficients it has, where there is a choice.
    """

    name: str
    lens: str
    terms: int | None = None


class FisheyesExperiment(Experiment):
    """A wide camera calibrated with several lenses; of views held out only the boards' poses are fitted.

    Attributes:
        board: A board of BabelCalib's data (`.dsc`), relative to the configuration; the corners (`.orpc`) are in the
            folders `corners/train` and `corners/test` beside it.
        models: The lenses.
        reference_train: The RMS of other software on the same corners, if known, in pixels.
        reference_test: The same of the views held out.
    """

    board: Annotated[str, InputFile("board of BabelCalib")]
    models: list[FisheyeModel] = Field(min_length=1, max_length=12)
    reference_train: float | None = None
    reference_test: float | None = None

    def run(self, configuration: Configuration, folder: Path, progress: Console) -> Outcome:
        """Carries out the experiment: `table.csv` has every parameter, `models.csv` what is left over.

        Raises:
            ExperimentError: the corners cannot be read, or a lens cannot be fitted to them.
        """
        path = configuration.file(self.board)
        points = _read_board(path)
        size, train, names = _read_corners(path.parent / "corners" / "train", points)
        other_size, test, _ = _read_corners(path.parent / "corners" / "test", points)
        if size != other_size:
            raise ExperimentError(f"pictures to train on are {size}, and to test {other_size}: one camera has one size")
        boards, held_out = jl.fitting.Boards.from_views(train), jl.fitting.Boards.from_views(test)
        table: list[tuple[Value, ...]] = []
        models: list[tuple[Value, ...]] = []
        fits: list[jl.fitting.Fit] = []
        with progress_bar(progress, self.name, len(self.models)) as advance:
            for model in self.models:
                fit = _calibrate(model, boards, size)
                assert fit.frame is not None
                assert isinstance(fit.lens, jl.Lens)
                fits.append(fit)
                errors = np.asarray(fit.standard_errors)
                for name, value, error in zip(fit.names, np.asarray(fit.values), errors, strict=True):
                    table.append((model.name, name, value, error))
                judged = jl.fitting.validate(fit.lens, fit.frame, held_out)
                angle = float(np.degrees(fit.lens.field_of_view()))
                status = jl.fitting.FitStatus(int(fit.status)).name.lower()
                models.append((model.name, len(fit.names), float(fit.rms), float(judged.rms), angle, status))
                advance(1)
        if self.reference_test is not None and self.reference_train is not None:
            models.append(("OpenCV's fisheye", 8, self.reference_train, self.reference_test, np.nan, ""))
        write_rows(folder, ("model", "parameter", "estimate", "standard_error"), table)
        header = ("model", "parameters", "train_rms", "test_rms", "field_of_view", "status")
        write_rows(folder, header, models, "models.csv")
        _draw(fits[0], boards, names, folder)
        facts = {"file": path.name, "sha256": file_sha256(path), "views": len(train), "held_out_views": len(test)}
        return Outcome([facts], {}, _report(self, models))


def _read_board(path: Path) -> np.ndarray:
    """The board's corners `(n, 2)`, in the order of their indices.

    Raises:
        ExperimentError: it is no such file.
    """
    try:
        rows = [line.split(",") for line in path.read_text("utf-8").splitlines()[2:] if line.strip()]
        places = np.array([[float(cell) for cell in row[3:6]] for row in rows])
        if places.shape[1:] != (3,) or np.ptp(places[:, 2]):
            raise ValueError("corners need x, y and one z")
    except (OSError, ValueError, IndexError) as error:
        raise ExperimentError(f"{str(path)!r} is no planar board of BabelCalib: {error}") from error
    return places[:, :2]


def _read_corners(folder: Path, points: np.ndarray) -> tuple[tuple[int, int], list[View], list[str]]:
    """The pictures' size, their views of the board, and their names.

    Raises:
        ExperimentError: no file, one that holds no corners, or pictures of several sizes.
    """
    files = sorted(folder.glob("*.orpc"))
    sizes, views = set(), []
    for path in files:
        try:
            header, rows = path.read_text("utf-8").split("encoding: ascii")
            facts = dict(line.split(": ") for line in header.splitlines() if line)
            sizes.add((int(facts["width"]), int(facts["height"])))
            cells = np.array([[float(cell) for cell in line.split(",")] for line in rows.split()])
            cells = cells[cells[:, 2] > 0]
            views.append((points[cells[:, 1].astype(int)], cells[:, 3:5]))
        except (OSError, ValueError, KeyError, IndexError) as error:
            raise ExperimentError(f"{str(path)!r} holds no corners of this board: {error}") from error
    if len(sizes) != 1:
        raise ExperimentError(f"{str(folder)!r} needs corners (.orpc) in pictures of one size; got {sorted(sizes)}")
    return sizes.pop(), views, [path.stem for path in files]


def _calibrate(model: FisheyeModel, boards: jl.fitting.Boards, size: tuple[int, int]) -> jl.fitting.Fit:
    """A calibration.

    Raises:
        ExperimentError: there is no such lens, or it cannot be fitted.
    """
    try:
        lens_class = jl.lenses.find_lens(model.lens)
        lens = lens_class.identity() if model.terms is None else lens_class.identity(terms=model.terms)
        return jl.fitting.calibrate(lens, boards, size, throw=False)
    except ValueError as error:
        raise ExperimentError(f"model {model.name!r}: {error}") from error


def _draw(fit: jl.fitting.Fit, boards: jl.fitting.Boards, names: list[str], folder: Path) -> None:
    seen = np.asarray(boards.weights) > 0
    observed = np.asarray(boards.observed)[seen]
    residuals = np.asarray(fit.residuals)[seen]
    figures.save(figures.residual_figure(observed, residuals, fit, "pixels"), folder / "residuals.png")
    figures.save(figures.uncertainty_figure(fit, observed), folder / "uncertainty.png")
    figures.save(figures.views_figure(names, np.asarray(fit.per_view_rms)), folder / "views.svg")


def _report(experiment: FisheyesExperiment, models: list[tuple[Value, ...]]) -> list[RenderableType]:
    header = ["model", "parameters", "RMS, px", "held out, px", "sees from the axis, °", "fit"]
    rows = [[f"{cell:.5f}" if isinstance(cell, float) else str(cell) for cell in row] for row in models]
    return [plain_table(experiment.heading, header, rows)]
