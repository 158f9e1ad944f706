"""What a fit returns: the lens, how well it is known, and whether to believe it."""

import warnings
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxlens.fitting._poses import Poses
from jaxlens.frames import Frame
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import Status, is_concrete

# A coefficient whose variance the others inflate more than this is traded against them, not measured: its own columns
# of the Jacobian, cleared of what poses explain, agree with a combination of the others' to one part in a thousand.
IDENTIFIED = 1e6
# Neighbouring residuals that share this much of their variance are no noise.
STRUCTURED = 0.3


class FitStatus(Status):
    """How a fit ended."""

    CONVERGED = 0
    """At a minimum, to the precision of the dtype."""
    MAX_STEPS = 1
    """Out of steps; the lens is the best found so far."""
    DIVERGED = 2
    """No step made the residuals smaller, though they are not at a minimum."""
    RANK_DEFICIENT = 3
    """The data leave a combination of the parameters undetermined."""
    TOO_FEW = 4
    """Fewer residuals than parameters."""
    NOT_FINITE = 5
    """The data, or the start's residuals, are not finite."""
    UNEXPLAINED = 6
    """Only from `fit_images`: the one picture through the lens does not look like the other."""


class FitError(RuntimeError):
    """A fit that did not reach a result worth having; the message says why."""


class FitWarning(UserWarning):
    """A fit whose result deserves a second look."""


class Fit(eqx.Module):
    """The result of every fit. It is a pytree: under `jax.vmap` its arrays have a leading batch axis.

    Attributes:
        lens: The fitted lens (or other map), with the values of `values` in it.
        frame: The frame between normalized coordinates and pixels: as given, or fitted (a camera matrix).
        poses: The poses of the boards, of `calibrate` only.
        names: The fitted parameters' names, in the order of everything below.
        values: Their values.
        covariance: Their covariance, with n − p degrees of freedom; with a robust loss by Huber's formula. NaN where
            the data do not determine it.
        information: JᵀJ, the columns of J scaled to length one, and cleared of what poses could explain as well.
        inflation: How many times the other parameters' being unknown inflates the variance of each. Poses are unknown
            either way.
        residuals: `(..., components)`, observed − predicted, not weighted; zero where the weight is zero.
        rms: The root of the mean squared length of the residuals, weighted.
        per_view_rms: The same for each view, of `calibrate` only.
        degrees_of_freedom: n − p: residual components less parameters (those of poses and of lines counted too).
        loss_scale: Where the robust loss bends, ∞ for `linear`.
        status_code: The number of `status`.
        steps: Steps of the solver, over all rounds of a robust loss.
        folds: Whether the lens folds over within the data or the picture.
        noise_correlation: Of `fit_lines`, the correlation of residuals that are neighbours on a line, beyond that of
            independent noise; zero where that may well be chance.
        noise_inflation: Of `fit_images`, how many times the correlation of residuals that are neighbours in the picture
            inflates the variance of each parameter (`covariance` has it in it); ones where there is none.
        image_size: Of `calibrate`, the width and height of the picture in pixels.
    """

    lens: CoordinateMap
    frame: Frame | None
    poses: Poses | None
    names: tuple[str, ...] = eqx.field(static=True)
    values: Float[Array, " parameters"]
    covariance: Float[Array, "parameters parameters"]
    information: Float[Array, "parameters parameters"]
    inflation: Float[Array, " parameters"]
    residuals: Float[Array, "*points components"]
    rms: Float[Array, ""]
    per_view_rms: Float[Array, " views"] | None
    degrees_of_freedom: Int[Array, ""]
    loss_scale: Float[Array, ""]
    status_code: Int[Array, ""]
    steps: Int[Array, ""]
    folds: Bool[Array, ""]
    noise_correlation: Float[Array, ""] | None = None
    noise_inflation: Float[Array, " parameters"] | None = None
    image_size: Float[Array, "2"] | None = None

    @property
    def status(self) -> FitStatus | Int[Array, "*batch"]:
        """How the fit ended. Of a batch of fits, and under `jax.jit` and `jax.vmap`, an array of the numbers."""
        return named_status(self.status_code)

    def __repr__(self) -> str:
        return eqx.tree_pformat(eqx.tree_at(lambda fit: fit.status_code, self, named_status(self.status_code)))

    @property
    def standard_errors(self) -> Float[Array, "*batch parameters"]:
        """The square roots of the variances, one for each name."""
        return jnp.sqrt(jnp.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def correlation(self) -> Float[Array, "*batch parameters parameters"]:
        """The correlations between the estimates."""
        errors = self.standard_errors
        return self.covariance / (errors[..., :, None] * errors[..., None, :])

    @property
    def parameters(self) -> dict[str, Float[Array, "*batch"]]:
        """The fitted values by name."""
        return {name: self.values[..., i] for i, name in enumerate(self.names)}

    @property
    def condition_number(self) -> Float[Array, "*batch"]:
        """The condition number of the Jacobian, its columns scaled to length one."""
        eigenvalues = jnp.linalg.eigvalsh(self.information)
        return jnp.sqrt(eigenvalues[..., -1] / jnp.maximum(eigenvalues[..., 0], 0))

    @property
    def weakest_direction(self) -> Float[Array, "*batch parameters"]:
        """The combination of (scaled) parameters that the data determine least, of length one."""
        return jnp.linalg.eigh(self.information)[1][..., 0]

    @property
    def unidentified(self) -> Bool[Array, "*batch parameters"]:
        """Which parameters are traded against others rather than measured: variance inflated over a million times."""
        return ~(self.inflation < IDENTIFIED)

    @property
    def camera_matrix(self) -> Float[Array, "3 3"]:
        """The frame as a camera matrix.

        Raises:
            ValueError: the fit has no frame.
        """
        if self.frame is None:
            raise ValueError("this fit has no frame, and so no camera matrix: its points were normalized already")
        return self.frame.camera_matrix()

    def projection_uncertainty(self, pixels: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
        """Returns how well a calibration knows where the camera puts a ray: one standard deviation, in pixels.

        The ray is the one that the fitted camera sees at the pixel. Another set of views, equally good, would give
        another camera, which sees that ray elsewhere; the standard deviation is that of this shift in the direction in
        which it is largest (as mrcal reports it), by the delta method. A camera that is another only by a rotation is
        the same camera, held another way, and the poses of the boards would follow: so the shift is what is left after
        the rotation that makes it smallest over the whole picture, in least squares. The poses count as unknown.

        Args:
            pixels: `(..., 2)`, (x, y) order, pixel centres at integers; a full grid is cheap.

        Returns:
            `(...)`, NaN where the camera sees no ray, or the covariance is unknown. Differentiable. It holds what noise
            leaves unknown, not what is wrong with a lens that does not fit, and beyond the corners that were seen it
            believes the lens.

        Raises:
            ValueError: the fit is no calibration from boards.
        """
        if self.image_size is None:
            raise ValueError("only a calibration knows a camera, and so the uncertainty of its projections")
        from jaxlens.fitting._uncertainty import projection_uncertainty

        return projection_uncertainty(self, pixels)

    def problems(self) -> list[str]:
        """Returns why the result deserves a second look, a sentence each; empty if nothing speaks against it."""
        found = []
        known = np.asarray(self.inflation) < IDENTIFIED
        weak = [name for name, flag in zip(self.names, known, strict=True) if not flag]
        if weak and int(self.status) == FitStatus.CONVERGED:
            found.append(
                f"{', '.join(weak)} {'is' if len(weak) == 1 else 'are'} not identified: the data fit almost as well "
                "with other values, if the rest is changed with them; fix some of them, or take a lens with fewer "
                "coefficients"
            )
        if bool(self.folds):
            found.append("the fitted lens folds over within the data or the picture: it is no model of a lens there")
        if self.noise_correlation is not None and float(self.noise_correlation) > STRUCTURED:
            found.append(
                f"noise does not explain the residuals: neighbours on a line agree (correlation "
                f"{float(self.noise_correlation):.2f}). The lens has too few coefficients, the lines are not straight, "
                "or this is a wrong minimum; start nearer to the solution"
            )
        return found

    def summary(self) -> str:
        """Returns a table of estimates, standard errors and diagnostics, as a statistician would read it."""
        from jaxlens.fitting._summary import summarize

        return summarize(self)


def named_status(code: Any) -> Any:
    """Returns the status that a number stands for, if it is one and known; trees may hold other leaves, as shapes."""
    known = isinstance(code, jax.Array | np.ndarray | np.integer) and is_concrete(code) and not code.ndim
    return FitStatus(int(code)) if known else code


def checked(fit: Fit, throw: bool) -> Fit:
    """Returns the fit; if its numbers are known by now, raises where it failed and warns where it is doubtful.

    Raises:
        FitError: `throw`, and the status is not `CONVERGED`.
    """
    if not is_concrete(fit):
        return fit
    if throw and FitStatus(int(fit.status)) != FitStatus.CONVERGED:
        raise FitError(explain(fit))
    for problem in Fit.problems(fit):  # a bound method of a Module takes a while to make
        warnings.warn(problem, FitWarning, stacklevel=3)
    return fit


def explain(fit: Fit) -> str:
    """Returns what a fit's status means for this fit."""
    status, steps = FitStatus(int(fit.status)), int(fit.steps)
    match status:
        case FitStatus.CONVERGED:
            return f"converged after {steps} steps"
        case FitStatus.MAX_STEPS:
            return f"not converged after {steps} steps: raise max_steps, or start nearer to the solution"
        case FitStatus.DIVERGED:
            return f"the solver is stuck after {steps} steps, at no minimum: start nearer to the solution"
        case FitStatus.TOO_FEW:
            return f"the data have fewer residuals than there are parameters: {', '.join(fit.names)}"
        case FitStatus.NOT_FINITE:
            return "the data, or the residuals at the start, are not finite"
        case FitStatus.UNEXPLAINED:
            return (
                "the source through the lens does not look like the distorted picture: is it the same scene, of the "
                "same size and not turned? Give a start nearer to the solution, or a mask"
            )
    share = np.abs(np.asarray(fit.weakest_direction))
    involved = [name for name, part in zip(fit.names, share, strict=True) if not part < 0.05]
    together = f"{', '.join(involved)} separately" if len(involved) > 1 else "".join(involved)
    remedy = "give more varied data, or fix some of the parameters by `free`"
    if fit.poses is not None:
        remedy = "show the board at more angles (parallel boards tell no more than one), or fix some parameters"
    return f"the data do not determine {together} (condition number {float(fit.condition_number):.1e}): {remedy}"
