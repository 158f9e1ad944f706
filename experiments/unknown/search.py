"""The picture behind Table 1, which was never published: which pictures of a face come near its table.

Twelve figures of the table tell of the picture: the six RMSE that its PSNR imply, five MAE (the sixth was copied from
another row), and the root of the mean square that PSNR − SNR implies. Its peak is met by scaling. All differences are
ratios in decibels, 20 log₁₀(ours / theirs).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxlens.experiments import READINGS, Reading, paper, source_map
from jaxlens.fitting import Problem, Unknowns, minimize
from jaxlens.sampling import remap

from .portraits import PARAMETERS, Template, bounds, random_parameters, render

KAPPA = np.array([row.kappa for row in paper.TABLE_1])
TRUSTED = tuple(index for index, row in enumerate(paper.TABLE_1) if not row.copied)
"""Rows whose RMSE and MAE are their own."""
LABELS = (
    *(f"RMSE {row.kappa[0]:g}, {row.kappa[1]:g}" for row in paper.TABLE_1),
    *(f"MAE {paper.TABLE_1[index].kappa[0]:g}, {paper.TABLE_1[index].kappa[1]:g}" for index in TRUSTED),
    "RMS",
)
"""What the twelve figures are."""

# Radii at which the readings' factors are tabulated: their error is then below 1e-6.
_RADII = np.linspace(0, 1.05, 2049)
# Of a fit, and how often the best one is taken up again: the way to the minimum is long and crooked.
_MOST_STEPS, _ROUNDS = 20, 2
# The share of random pictures from which starts are taken.
_GOOD = 0.06


@dataclass(frozen=True)
class Hypothesis:
    """How Eq. 11 and the table are read.

    Attributes:
        reading: Of Eq. 11.
        exchanged: Whether the labels of the last two rows, (3, 2) and (3, 1), are taken to be exchanged.
    """

    reading: Reading
    exchanged: bool

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.reading}, last rows exchanged" if self.exchanged else self.reading


HYPOTHESES = tuple(Hypothesis(reading, exchanged) for exchanged in (False, True) for reading in READINGS)


@dataclass(frozen=True, eq=False)
class Found:
    """A picture that comes as near to the table as it can.

    Attributes:
        hypothesis: How Eq. 11 and the table are read.
        parameters: Of the picture, as in `PARAMETERS`.
        residuals: `(12,)`, ours less theirs in decibels.
        measures: `(12,)`, ours in gray levels.
        jacobian: `(12, parameters)` of the residuals.
        loss: Half the sum of squares, expectations included.
    """

    hypothesis: Hypothesis
    parameters: Float[np.ndarray, " parameters"]
    residuals: Float[np.ndarray, " figures"]
    measures: Float[np.ndarray, " figures"]
    jacobian: Float[np.ndarray, "figures parameters"]
    loss: float

    @property
    def rms(self) -> float:
        """The root of the mean squared residual, in decibels."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def knowledge(self, noise: float) -> "Knowledge":
        """Returns what the table tells about the parameters, if its figures are off by that much, in decibels."""
        _, spread, *_ = bounds()
        # In units of what is expected.
        slopes = self.jacobian * spread / noise
        covariance = np.linalg.inv(slopes.T @ slopes + np.eye(len(spread)))
        errors = np.sqrt(np.diag(covariance))
        return Knowledge(
            spread * errors, errors, covariance / np.outer(errors, errors), np.linalg.svd(slopes, compute_uv=False)
        )


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What the table tells about a picture's parameters, to first order.

    Attributes:
        standard_errors: Of the parameters, from table and expectation together.
        narrowed: The same, as shares of the expectation's own spread: one where the table tells nothing.
        correlations: Of the parameters.
        strengths: Singular values of the table's slopes, in units of expectation and noise, the largest first: those
            above one are combinations of parameters that the table tells more about than was expected before.
    """

    standard_errors: Float[np.ndarray, " parameters"]
    narrowed: Float[np.ndarray, " parameters"]
    correlations: Float[np.ndarray, "parameters parameters"]
    strengths: Float[np.ndarray, " parameters"]

    @property
    def condition(self) -> float:
        """The ratio of the strongest to the weakest."""
        return float(self.strengths[0] / self.strengths[-1])


def goal(exchanged: bool) -> Float[np.ndarray, " figures"]:
    """Returns the twelve figures in gray levels: RMSE as PSNR implies it, MAE, and the root of the mean square."""
    rows = list(paper.TABLE_1)
    if exchanged:
        rows[-2:] = rows[:-3:-1]
    errors = [paper.implied_rmse(row.psnr) for row in rows] + [rows[index].mae for index in TRUSTED]
    offset = float(np.mean([row.psnr - row.snr for row in rows]))
    return np.array([*errors, paper.root_mean_square(offset)])


def source_factors(reading: Reading, dtype: str) -> Float[Array, "lenses radii"]:
    """Returns, for each lens of the table, by what a reading of Eq. 11 multiplies an output point."""
    radii = jnp.asarray(np.maximum(_RADII, 1e-9))
    points = jnp.stack([radii, jnp.zeros_like(radii)], axis=-1)
    factors = [source_map(jnp.asarray(one), reading)(points)[:, 0] / radii for one in KAPPA]
    return jnp.stack(factors).astype(dtype)


def measures(
    picture: Float[Array, "size size"],
    log_aspect: Float[Array, ""],
    factors: Float[Array, "lenses radii"],
    *,
    softness: float = 0.0,
) -> Float[Array, " figures"]:
    """Measures a picture on a square grid against its own deformations, as the table does.

    Lenses stand in the middle of the picture, and not, as Eq. 10's, half a pixel off it, for nobody knows how large the
    unknown picture's pixels are. So a picture that is mirrored or upside down has the same figures.

    Args:
        picture: In gray levels.
        log_aspect: The logarithm of the picture's width over its height.
        factors: Of a reading of Eq. 11.
        softness: Errors below this, in gray levels, count as their squares do in MAE; 0 is MAE itself.
    """
    size, dtype = picture.shape[0], picture.dtype
    aspect = jnp.exp(log_aspect)
    diagonal = jnp.sqrt(1 + aspect**2)
    steps = (2 * jnp.arange(size, dtype=dtype) + 1) / size - 1
    x, y = jnp.meshgrid(steps * aspect / diagonal, steps / diagonal)
    radius = jnp.sqrt(x**2 + y**2 + 1e-12)
    scale = 0.5 * size * diagonal

    def errors(table: Array) -> Array:
        factor = jnp.interp(radius, jnp.asarray(_RADII, dtype), table)
        source = jnp.stack([factor * x * (scale / aspect), factor * y * scale], axis=-1) + 0.5 * (size - 1)
        error = picture - remap(picture, source)
        size_of_error = jnp.sqrt(error**2 + softness**2) if softness else jnp.abs(error)
        return jnp.stack([jnp.sqrt(jnp.mean(error**2)), jnp.mean(size_of_error)])

    found = jax.vmap(errors)(factors)
    trusted = jnp.asarray(TRUSTED)
    return jnp.concatenate([found[:, 0], found[trusted, 1], jnp.sqrt(jnp.mean(picture**2))[None]])


class TableProblem(Problem):
    """Find the parameters of a picture from the table, and from what is expected of a picture.

    The residuals are in units of their standard deviations: those of the table first, then those of expectations.

    Attributes:
        weights: All one.
        template: The face.
        factors: Of the reading.
        goal: The table's figures, in gray levels.
        noise: Their standard deviation, in decibels.
        middle: The expected parameters.
        spread: Their standard deviations.
        lower: The least that they may be.
        upper: The largest.
        size: Of the grid.
    """

    weights: Float[Array, "1 residuals"]
    template: Template
    factors: Float[Array, "lenses radii"]
    goal: Float[Array, " figures"]
    noise: Float[Array, ""]
    middle: Float[Array, " parameters"]
    spread: Float[Array, " parameters"]
    lower: Float[Array, " parameters"]
    upper: Float[Array, " parameters"]
    size: int = eqx.field(static=True)

    def decibels(self, parameters: Float[Array, " parameters"]) -> Float[Array, " figures"]:
        """Returns ours less theirs."""
        return 20 * jnp.log10(self.measures(parameters) / self.goal)

    def measures(self, parameters: Float[Array, " parameters"]) -> Float[Array, " figures"]:
        """Returns ours, in gray levels."""
        picture = render(self.template, parameters, self.size, paper.PEAK)
        return measures(picture, parameters[-1], self.factors)

    def residuals(self, unknowns: Unknowns) -> Float[Array, "1 residuals 1"]:
        """Returns the residuals."""
        expected = (unknowns.shared - self.middle) / self.spread
        return jnp.concatenate([self.decibels(unknowns.shared) / self.noise, expected])[None, :, None]


def distinct(found: Sequence[Found], count: int, worse: float = 0.15) -> list[Found]:
    """Returns the best, and those among the nearly as good that differ most from what is already chosen.

    Args:
        found: All that was found.
        count: How many to return, if there are so many.
        worse: By how much the RMS may exceed that of the best, in decibels.
    """
    best = min(found, key=lambda one: one.loss)
    good = [best, *(one for one in found if one is not best and one.rms <= best.rms + worse)]
    return [good[index] for index in _far_apart(np.stack([one.parameters for one in good]), count)]


def _far_apart(many: Float[np.ndarray, "count parameters"], count: int) -> list[int]:
    """The first, and then again and again the one that is farthest from all that are chosen."""
    _, spread, *_ = bounds()
    scaled, chosen = many / spread, list(range(min(count, 1)))
    while len(chosen) < min(count, len(many)):
        distances = np.linalg.norm(scaled[:, None] - scaled[chosen], axis=-1).min(axis=1)
        chosen.append(int(np.argmax(distances)))
    return chosen


class Search:
    """Pictures near the table, for one size of the grid and one noise.

    Attributes:
        template: The face.
    """

    def __init__(self, size: int, noise: float, dtype: str):
        self._size, self._noise, self._dtype = size, noise, dtype
        self.template = Template.of(size, dtype)
        self._factors = {reading: source_factors(reading, dtype) for reading in READINGS}

    def problem(self, hypothesis: Hypothesis, held: tuple[int, float] | None = None) -> TableProblem:
        """Returns the problem of a hypothesis; on request with one parameter held at a value."""
        middle, spread, lower, upper = bounds()
        if held is not None:
            lower[held[0]] = upper[held[0]] = held[1]
        weights = np.ones((1, len(LABELS) + len(PARAMETERS)))
        arrays = (weights, goal(hypothesis.exchanged), self._noise, middle, spread, lower, upper)
        weights, figures, noise, *expected = (jnp.asarray(array, self._dtype) for array in arrays)
        factors = self._factors[hypothesis.reading]
        return TableProblem(weights, self.template, factors, figures, noise, *expected, size=self._size)

    def screened(self, hypothesis: Hypothesis, candidates: int, count: int, seed: int) -> np.ndarray:
        """Returns the best of many random pictures; half of them instead not much worse, and far apart."""
        drawn = random_parameters(candidates, seed)
        losses = np.asarray(_losses(self.problem(hypothesis), jnp.asarray(drawn, self._dtype)))
        order = np.argsort(losses, kind="stable")
        best = -(-count // 2)
        others = drawn[order[best : max(count, round(_GOOD * candidates))]]
        return np.concatenate([drawn[order[:best]], others[_far_apart(others, count - best)]])

    def fitted(self, hypothesis: Hypothesis, start: np.ndarray, held: tuple[int, float] | None = None) -> Found:
        """Fits from a start."""
        problem = self.problem(hypothesis, held)
        parameters, loss = _fit(problem, jnp.asarray(start, self._dtype))
        residuals, measured, jacobian = _looked_at(problem, parameters)
        return Found(
            hypothesis,
            np.asarray(parameters, np.float64),
            np.asarray(residuals, np.float64),
            np.asarray(measured, np.float64),
            np.asarray(jacobian, np.float64),
            float(loss),
        )

    def refined(self, found: Found) -> Found:
        """Goes on from what was found, as long as that gains anything."""
        for _ in range(_ROUNDS):
            better = self.fitted(found.hypothesis, found.parameters)
            if not better.loss < found.loss:
                break
            found = better
        return found

    def profile(self, best: Found, name: str, values: Sequence[float]) -> list[Found]:
        """Holds a parameter at values, and fits the rest anew, outwards from the best: each from its neighbour."""
        index = next(index for index, one in enumerate(PARAMETERS) if one.name == name)
        own, found = best.parameters[index], {}
        for side in (sorted(v for v in values if v >= own), sorted((v for v in values if v < own), reverse=True)):
            last = best
            for value in side:
                held = (index, value)
                for _ in range(1 + _ROUNDS):
                    last = self.fitted(best.hypothesis, last.parameters, held)
                found[value] = last
        return [found[value] for value in values]

    def picture(self, parameters: Sequence[float] | np.ndarray) -> Float[np.ndarray, "size size"]:
        """Returns the picture of parameters."""
        return np.asarray(_picture(self.template, jnp.asarray(parameters, self._dtype), self._size))

    def factors(self, reading: Reading) -> Float[Array, "lenses radii"]:
        """Returns the factors of a reading."""
        return self._factors[reading]


@jax.jit
def _losses(problem: TableProblem, many: Float[Array, "count parameters"]) -> Float[Array, " count"]:
    def loss(parameters: Array) -> Array:
        return 0.5 * jnp.sum(problem.weighted(Unknowns(parameters, jnp.zeros((1, 0), many.dtype))) ** 2)

    return lax.map(loss, many)


@jax.jit
def _fit(
    problem: TableProblem, start: Float[Array, " parameters"]
) -> tuple[Float[Array, " parameters"], Float[Array, ""]]:
    lower, upper = problem.lower, problem.upper
    begin = Unknowns(start, jnp.zeros((1, 0), start.dtype))
    found = minimize(problem, begin, bounds=(lower, upper), max_steps=_MOST_STEPS)
    return found.unknowns.shared, 0.5 * jnp.sum(problem.weighted(found.unknowns) ** 2)


@jax.jit
def _looked_at(problem: TableProblem, parameters: Float[Array, " parameters"]) -> tuple[Array, Array, Array]:
    return problem.decibels(parameters), problem.measures(parameters), jax.jacfwd(problem.decibels)(parameters)


@partial(jax.jit, static_argnames="size")
def _picture(template: Template, parameters: Float[Array, " parameters"], size: int) -> Float[Array, "size size"]:
    return render(template, parameters, size, paper.PEAK)
