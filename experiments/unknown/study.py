"""The picture behind Table 1: how near a rendered face comes, and what the table can tell of it and what not."""

from pathlib import Path

import numpy as np
from rich.console import Console, RenderableType
from rich.text import Text

from jaxlens.experiments import (
    READINGS,
    Outcome,
    Reading,
    Value,
    Warp,
    deform_all,
    paper,
    plain_table,
    progress_bar,
    write_csv,
    write_rows,
)
from jaxlens.figures import save

from . import UnknownExperiment
from .exact import Exact, nearest_exact
from .panels import exact_panel, knowledge_chart, picture_panel, profile_chart, residual_chart
from .portraits import PARAMETERS, bounds, render_fine
from .search import HYPOTHESES, KAPPA, LABELS, TRUSTED, Found, Hypothesis, Search, distinct, goal

# Pictures shown of each reading, and those of them that are changed until they meet the table.
_SHOWN, _CHANGED = 3, 2
_FIGURES = ("reading", "exchanged", "figure", "paper", "ours", "difference_db")
_PARAMETERS = ("reading", "exchanged", "picture", "rms_db", "parameter", "estimate", "standard_error", "narrowed_to")

Best = dict[Hypothesis, list[Found]]


def study(experiment: UnknownExperiment, folder: Path, progress: Console) -> Outcome:
    """Carries out the experiment: `table.csv` has the figures of the nearest pictures, `parameters.csv` theirs."""
    printed = [one for one in HYPOTHESES if not one.exchanged]
    steps = len(HYPOTHESES) * experiment.starts + len(printed) * (len(experiment.profile) + _CHANGED)
    with progress_bar(progress, experiment.name, steps) as advance:
        search = Search(experiment.size, experiment.noise, experiment.dtype)
        best: Best = {}
        for hypothesis in HYPOTHESES:
            found = []
            for start in search.screened(hypothesis, experiment.candidates, experiment.starts, experiment.seed):
                found.append(search.fitted(hypothesis, start))
                advance(1)
            first, *others = distinct(found, _SHOWN)
            best[hypothesis] = [search.refined(first), *others]
        profiles: dict[Reading, list[Found]] = {}
        exact: dict[Reading, list[tuple[Exact, float]]] = {one.reading: [] for one in printed}
        for hypothesis in printed:
            views = [float(np.log(view)) for view in experiment.profile]
            profiles[hypothesis.reading] = search.profile(best[hypothesis][0], "log_view", views)
            advance(len(views))
            for one in best[hypothesis][:_CHANGED]:
                exact[hypothesis.reading].append(_changed(search, one))
            advance(_CHANGED)
    nearest: dict[bool, dict[Reading, Found]] = {
        exchanged: {one.reading: best[one][0] for one in HYPOTHESES if one.exchanged == exchanged}
        for exchanged in (False, True)
    }
    pictures: dict[Reading, list[tuple[np.ndarray, float]]] = {
        one.reading: [(render_fine(each.parameters, experiment.fine, paper.PEAK), each.rms) for each in best[one]]
        for one in printed
    }
    again: dict[Reading, np.ndarray] = {
        reading: _measured_again(several[0][0], reading, experiment.dtype) for reading, several in pictures.items()
    }
    write_rows(folder, _FIGURES, _figures(best))
    write_rows(folder, (*_PARAMETERS, "at_bound"), _parameters(best, experiment.noise), "parameters.csv")
    write_csv(folder, _profile(experiment.profile, profiles), "profiles.csv")
    save(picture_panel(pictures), folder / "pictures.jpg")
    save(residual_chart(nearest, experiment.noise), folder / "residuals.svg")
    save(knowledge_chart(nearest[False], experiment.noise), folder / "knowledge.svg")
    save(profile_chart(experiment.profile, profiles, nearest[False]), folder / "profile.svg")
    met: list[tuple[Exact, float, Reading]] = [
        (one, aspect, reading) for reading in READINGS for one, aspect in exact[reading] if one.met
    ]
    if met:
        save(exact_panel(met), folder / "exact.jpg")
    return Outcome([], _facts(best, exact, again, experiment.noise), _report(experiment, best, exact, again))


def _changed(search: Search, found: Found) -> tuple[Exact, float]:
    reading, aspect = found.hypothesis.reading, found.parameters[-1]
    figures = goal(found.hypothesis.exchanged)
    one = nearest_exact(search.picture(found.parameters), aspect, search.factors(reading), figures)
    return one, float(np.exp(aspect))


def _measured_again(picture: np.ndarray, reading: Reading, dtype: str) -> np.ndarray:
    """The twelve figures of a picture of whole gray levels, deformed as in a sweep, in decibels from the table's."""
    pixels = picture.astype(dtype)
    errors = np.stack(deform_all(pixels, KAPPA, Warp(), reading)) - pixels
    root, mean = np.sqrt(np.mean(errors**2, axis=(1, 2))), np.mean(np.abs(errors), axis=(1, 2))
    ours = np.concatenate([root, mean[list(TRUSTED)], [np.sqrt(np.mean(pixels**2))]])
    return 20 * np.log10(ours / goal(False))


def _figures(best: Best) -> list[tuple[Value, ...]]:
    return [
        (one.reading, _yes(one.exchanged), *row)
        for one, (first, *_) in best.items()
        for row in zip(LABELS, goal(one.exchanged), first.measures, first.residuals, strict=True)
    ]


def _parameters(best: Best, noise: float) -> list[tuple[Value, ...]]:
    *_, lower, upper = bounds()
    rows: list[tuple[Value, ...]] = []
    for hypothesis, several in best.items():
        for number, one in enumerate(several, 1):
            picture = (hypothesis.reading, _yes(hypothesis.exchanged), number, one.rms)
            known = one.knowledge(noise)
            at_bound = (one.parameters <= lower) | (one.parameters >= upper)
            for parameter, *values, bound in zip(
                PARAMETERS, one.parameters, known.standard_errors, known.narrowed, at_bound, strict=True
            ):
                rows.append((*picture, parameter.name, *values, _yes(bool(bound))))
    return rows


def _profile(views: list[float], profiles: dict[Reading, list[Found]]) -> dict[str, list[Value]]:
    return {
        "reading": [reading for reading in profiles for _ in views],
        "view": [view for _ in profiles for view in views],
        "rms_db": [one.rms for several in profiles.values() for one in several],
    }


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _facts(
    best: Best, exact: dict[Reading, list[tuple[Exact, float]]], again: dict[Reading, np.ndarray], noise: float
) -> dict[str, object]:
    first = {hypothesis.name: several[0] for hypothesis, several in best.items()}
    return {
        "rms_db": {name: one.rms for name, one in first.items()},
        "rms_db_whole_gray_levels": {name: float(np.sqrt(np.mean(one**2))) for name, one in again.items()},
        "combinations_determined": {
            name: int(np.sum(one.knowledge(noise).strengths > 1)) for name, one in first.items()
        },
        "condition": {name: one.knowledge(noise).condition for name, one in first.items()},
        "exact_change": {
            reading: [one.change if one.met else "not found" for one, _ in several]
            for reading, several in exact.items()
        },
    }


def _report(
    experiment: UnknownExperiment,
    best: Best,
    exact: dict[Reading, list[tuple[Exact, float]]],
    again: dict[Reading, np.ndarray],
) -> list[RenderableType]:
    rows = []
    for hypothesis, several in best.items():
        one, known = several[0], several[0].knowledge(experiment.noise)
        worst = int(np.argmax(np.abs(one.residuals)))
        gray = one.measures - goal(hypothesis.exchanged)
        rows.append(
            [
                hypothesis.reading,
                "exchanged" if hypothesis.exchanged else "as printed",
                f"{one.rms:.3f}",
                f"{one.residuals[worst]:+.2f} ({LABELS[worst]})",
                f"{np.sqrt(np.mean(gray**2)):.2f}",
                f"{np.sum(known.strengths > 1)} of {len(PARAMETERS)}",
                f"{known.condition:.0f}",
            ]
        )
    header = ["reading", "last rows", "RMS\ndB", "worst\ndB", "RMS\ngray", "determined", "condition"]
    printed = [one for one in best if not one.exchanged]
    lines = []
    for reading in READINGS:
        several = exact[reading]
        changes = [f"{one.change:.1f}" for one, _ in several if one.met]
        text = f"after changes of {' and '.join(changes)} gray levels (RMS)" if changes else "not found nearby"
        lines.append(f"  {reading}: {text}")
    estimates = [(best[one][0], best[one][0].knowledge(experiment.noise)) for one in printed]
    table = plain_table(
        "Estimates ± standard errors; of heights, gamma and aspect the logarithms",
        ["", "expected", *(one.reading for one in printed)],
        [
            [parameter.meaning, f"{parameter.middle:g} ± {parameter.spread:g}"]
            + [f"{one.parameters[index]:.2f} ± {known.standard_errors[index]:.2f}" for one, known in estimates]
            for index, parameter in enumerate(PARAMETERS)
        ],
    )
    whole = ", ".join(f"{reading} {np.sqrt(np.mean(one**2)):.3f}" for reading, one in again.items())
    return [
        plain_table(experiment.title or experiment.name, header, rows),
        Text(f"With square pixels and whole gray levels, RMS in dB: {whole}.\n"),
        table,
        Text("Pictures with exactly the table's figures, as printed:\n" + "\n".join(lines)),
    ]
