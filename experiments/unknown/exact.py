"""Pictures that meet Table 1 to the last digit, near to one that does not: by changing its pixels."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxlens.experiments import paper

from .search import measures

# Steps towards the table, each by a share of what is left.
_SHARES = (0.15,) * 30 + (0.6,) * 20
# Gray levels below which an error's sign does not count for the direction of a step: MAE has a kink at zero.
_SOFT = 2.0
_MET = 1e-6


@dataclass(frozen=True, eq=False)
class Exact:
    """A picture that was changed to meet the table.

    Attributes:
        before: The picture, in gray levels.
        after: What became of it.
        off: The largest difference from the table that is left, in decibels.
    """

    before: Float[np.ndarray, "size size"]
    after: Float[np.ndarray, "size size"]
    off: float

    @property
    def met(self) -> bool:
        """Whether all figures are those of the table, to more digits than it prints."""
        return self.off < _MET

    @property
    def change(self) -> float:
        """The root of the mean squared change, in gray levels."""
        return float(np.sqrt(np.mean((self.after - self.before) ** 2)))


def nearest_exact(
    picture: Float[np.ndarray, "size size"],
    log_aspect: float,
    factors: Float[Array, "lenses radii"],
    goal: Float[np.ndarray, " figures"],
) -> Exact:
    """Changes a picture, pixel by pixel, until it has the table's figures and peak; gray levels stay within 0 to 193.

    Every step is the smallest that does its share, so that the whole change is small, if not the smallest. Where the
    way is long, it may lead nowhere: `met` tells.
    """
    dtype = factors.dtype
    arrays = (jnp.asarray(one, dtype) for one in (picture, log_aspect, goal))
    start, aspect, figures = arrays
    after, off = _approach(start, aspect, factors, figures)
    return Exact(np.asarray(picture), np.asarray(after), float(off))


@jax.jit
def _approach(
    picture: Float[Array, "size size"],
    log_aspect: Float[Array, ""],
    factors: Float[Array, "lenses radii"],
    goal: Float[Array, " figures"],
) -> tuple[Float[Array, "size size"], Float[Array, ""]]:
    def off(change: Array, softness: float) -> Float[Array, " constraints"]:
        changed = jnp.clip(picture + change, 0, paper.PEAK)
        ratios = measures(changed, log_aspect, factors, softness=softness) / goal
        return jnp.log(jnp.concatenate([ratios, jnp.max(changed)[None] / paper.PEAK]))

    def step(change: Array, share: Array) -> tuple[Array, None]:
        left = off(change, 0.0)
        slopes = jax.jacrev(lambda change: off(change, _SOFT))(change).reshape(left.shape[0], -1)
        gram = slopes @ slopes.T
        tiny = 1e-10 * jnp.trace(gram) * jnp.eye(left.shape[0], dtype=left.dtype)
        multipliers = jnp.linalg.solve(gram + tiny, share * left)
        return change - (multipliers @ slopes).reshape(change.shape), None

    change, _ = lax.scan(step, jnp.zeros_like(picture), jnp.asarray(_SHARES, picture.dtype))
    decibels = 20 / jnp.log(10.0).astype(picture.dtype) * jnp.abs(off(change, 0.0))
    return jnp.clip(picture + change, 0, paper.PEAK), jnp.max(decibels)
