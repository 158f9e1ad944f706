"""Calibration from views of a planar board: camera matrix, lens and poses, by bundle adjustment."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float, Int, PyTree

from jaxlens.deformations import direct_linear_transform
from jaxlens.fitting._arguments import (
    Bounds,
    Static,
    as_weights,
    bound_vectors,
    check_count,
    check_loss,
    check_solver,
    common_dtype,
    is_concrete,
)
from jaxlens.fitting._board_starts import (
    equidistant_start,
    focal_lengths,
    poses_from_homographies,
    poses_from_rays,
)
from jaxlens.fitting._parameters import Choice, Selection, choose, free_mask, in_dtype, without
from jaxlens.fitting._poses import Poses
from jaxlens.fitting._problem import Knowledge, Minimum, Problem, assess, minimize, report
from jaxlens.fitting._result import Fit, FitStatus, checked
from jaxlens.fitting._robust import Loss
from jaxlens.fitting._solver import Unknowns
from jaxlens.fitting._uncertainty import (
    best_rotation,
    covariance_of_pixels,
    frame_of,
    is_wide,
    model_of,
    root_of,
    seen_at,
)
from jaxlens.frames import Frame
from jaxlens.lenses import Lens
from jaxlens.numerics import as_floating, as_points

# Corners without which a view has no homography, and the numbers of a pose.
_CORNERS, _POSE = 4, 6
_CAMERA = ("fx", "fy", "cx", "cy")
# Projections that are known no better than to this share of the picture's diagonal are not known; and corners of a view
# at which that is asked.
_USELESS, _CORNERS_A_VIEW = 0.01, 16
# Sine of the angle that two boards must make to be called not parallel.
_PARALLEL = 0.035


class Boards(eqx.Module):
    """Views of planar boards: where corners lie on the board, and where they are seen.

    Attributes:
        points: `(V, N, 2)` corners in the board's plane, in the units that its poses will have.
        observed: `(V, N, 2)` the same corners in pixels, (x, y) order; zero where missing.
        weights: `(V, N)` inverse variances up to a common factor; zero where a corner is missing.
    """

    points: Float[Array, "views corners 2"]
    observed: Float[Array, "views corners 2"]
    weights: Float[Array, "views corners"]

    def __init__(
        self,
        points: Float[ArrayLike, "*views corners 2"],
        observed: Float[ArrayLike, "views corners 2"],
        *,
        weights: Float[ArrayLike, "views corners"] | None = None,
    ):
        """Makes views of one board `(N, 2)`, or of one board a view; NaN in `observed` marks a missing corner.

        Raises:
            ValueError: shapes that do not fit.
        """
        observed, points = as_points(observed), as_points(points)
        if observed.ndim != 3 or points.ndim not in (2, 3) or points.shape[-2] != observed.shape[1]:
            raise ValueError(
                "boards need points of shape (N, 2) or (V, N, 2), and observed of shape (V, N, 2), with as many "
                "corners; "
                f"got {points.shape} and {observed.shape} (views of boards of different size: Boards.from_views)"
            )
        if points.ndim == 3 and points.shape[0] != observed.shape[0]:
            raise ValueError(
                f"boards need as many views in points as in observed, got {points.shape} and {observed.shape}"
            )
        seen = jnp.all(jnp.isfinite(observed), axis=-1)
        given = jnp.asarray(as_weights(weights, observed.shape[:2]), observed.dtype)
        self.points = jnp.broadcast_to(points, observed.shape)
        self.observed = jnp.where(seen[..., None], observed, 0)
        self.weights = jnp.where(seen, given, 0)

    @classmethod
    def from_views(cls, views: Sequence[tuple[ArrayLike, ArrayLike]]) -> "Boards":
        """Makes boards of a list of views with corners of their own: pairs of `(n, 2)` board and image points.

        Raises:
            ValueError: a view with unequally many points on the board and in the image.
        """
        pairs = [(as_floating(board), as_floating(seen)) for board, seen in views]
        if not pairs:
            raise ValueError("no views")
        for index, (board, seen) in enumerate(pairs):
            if board.shape != seen.shape or board.ndim != 2 or board.shape[1] != 2:
                raise ValueError(
                    f"view {index} needs as many board points as image points, each (n, 2); "
                    f"got {board.shape} and {seen.shape}"
                )
        most = max(board.shape[0] for board, _ in pairs)

        def padded(array, filling):
            missing = jnp.full((most - array.shape[0], 2), filling, array.dtype)
            return jnp.concatenate([array, missing])

        return cls(
            jnp.stack([padded(board, 0.0) for board, _ in pairs]),
            jnp.stack([padded(seen, jnp.nan) for _, seen in pairs]),
        )

    def view(self, chosen: ArrayLike) -> "Boards":
        """Returns some of the views: an index array, a slice or a boolean mask."""
        return jax.tree.map(lambda leaf: leaf[chosen], self)


class _Boards(Problem):
    selection: Selection
    boards: Boards
    weights: Float[Array, "views corners"]

    def residuals(self, unknowns: Unknowns) -> Float[Array, "views corners 2"]:
        model = self.selection.insert(unknowns.shared)
        predicted = seen_at(model["lens"], frame_of(model), _poses(unknowns.blocks).place(self.boards.points))
        return jnp.where((self.weights > 0)[..., None], self.boards.observed - predicted, 0)


def calibrate(
    lens: Lens,
    boards: Boards | Sequence[tuple[ArrayLike, ArrayLike]],
    image_size: tuple[int, int],
    *,
    camera_matrix: Float[ArrayLike, "3 3"] | None = None,
    free: PyTree | None = None,
    fixed: Sequence[str] = (),
    bounds: Bounds | None = None,
    loss: Loss = "linear",
    loss_scale: Float[ArrayLike, ""] | None = None,
    max_steps: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    throw: bool = True,
) -> Fit:
    """Calibrates a camera by Zhang's method: camera matrix, lens and board poses from views of a planar board.

    Each view's homography gives the start in closed form; bundle adjustment then minimizes the distances between
    observed corners and `frame.denormalize(lens.distort(pose.project(corner)))`.

    Args:
        lens: The model, and where its coefficients start: `BrownConrady([0.0] * 5)` is OpenCV's default.
        boards: The views, as `Boards` or as a list for `Boards.from_views`: pairs of `(n, 2)` points on the board and
            in the image. At least two, with boards that are not parallel to each other.
        image_size: (width, height) in pixels.
        camera_matrix: A start for the camera, instead of the closed form with the principal point in the middle; with
            it, `lens` is believed, too.
        free: Which numbers of the lens are fitted, as in `fit_points`.
        fixed: Names of parameters that keep their start: `("cx", "cy")`.
        bounds: By parameter, as in `fit_points`; the camera's are fx, fy, cx and cy, in pixels.
        loss: As in `fit_points`.
        loss_scale: As in `fit_points`, in pixels.
        max_steps: As in `fit_points`.
        solver: As in `fit_points`.
        throw: As in `fit_points`.

    Returns:
        A `Fit`: its `frame` is the camera, `poses` the boards' (one for each view), `residuals` `(V, N, 2)` in pixels,
        `rms` and `per_view_rms` root mean square distances in pixels, as OpenCV defines them. Its degrees of freedom
        count the poses. Differentiable in the boards by the implicit function theorem.

    Raises:
        ValueError: too few views or corners, or what does not fit.
        FitError: `throw`, and no result worth having; parallel boards are `RANK_DEFICIENT`.
    """
    check_loss(loss, loss_scale)
    check_solver(solver, bounded=bool(bounds))
    boards = boards if isinstance(boards, Boards) else Boards.from_views(boards)
    width, height = image_size
    views = boards.observed.shape[0]
    choice = without(_choice(lens, free), fixed)
    _check_views(boards, choice, views)
    check_count(2, boards.weights, choice.names, "corners", _POSE * views)
    dtype = common_dtype(lens, boards)
    fit = _fit(
        choice,
        lens,
        boards,
        jnp.asarray([width, height], dtype),
        camera_matrix,
        bound_vectors(bounds, choice.names),
        loss_scale,
        loss=loss,
        max_steps=max_steps,
        solver=Static(solver),
    )
    return checked(fit, throw)


def calibrated_parameters(lens: Lens, *, free: PyTree | None = None) -> tuple[str, ...]:
    """Returns the names of what `calibrate` fits: those that `fixed` and `bounds` take, in the order of `Fit.names`.

    Args:
        lens: The model.
        free: As of `calibrate`.

    Raises:
        ValueError: `free` does not fit the lens.

    Example:
        >>> import jaxlens as jl
        >>> jl.fitting.calibrated_parameters(jl.BrownConrady([0.0] * 4))
        ('fx', 'fy', 'cx', 'cy', 'k1', 'k2', 'p1', 'p2')
    """
    return _choice(lens, free).names


def _choice(lens: Lens, free: PyTree | None) -> Choice:
    model = {"camera": {"focal_length": np.zeros(2), "principal_point": np.zeros(2)}, "lens": lens}
    mask = {"camera": {"focal_length": True, "principal_point": True}, "lens": free_mask(lens, free, center=False)}
    return choose(model, mask)


@partial(jax.jit, static_argnames=("choice", "loss", "max_steps", "solver"))
def _fit(choice: Choice, lens, boards, size, camera_matrix, bounds, loss_scale, *, loss, max_steps, solver) -> Fit:
    dtype = size.dtype
    lens, boards, camera_matrix, bounds, loss_scale = in_dtype((lens, boards, camera_matrix, bounds, loss_scale), dtype)
    frame, poses = _start(lens, boards, size, camera_matrix)
    model = model_of(frame, lens)
    problem = _Boards(selection=Selection(model, choice), boards=boards, weights=boards.weights)
    start = Unknowns(problem.selection.values(), _blocks(poses))
    minimum = minimize(
        problem, start, loss=loss, loss_scale=loss_scale, bounds=bounds, max_steps=max_steps, solver=solver.tree
    )
    known = assess(problem, minimum, loss=loss)
    model = problem.selection.insert(minimum.unknowns.shared)
    poses, frame = _poses(minimum.unknowns.blocks), frame_of(model)
    diagonal = jnp.sqrt(jnp.sum(size**2))
    lost = ~(_unknown(problem.selection, minimum, known, boards) < _USELESS * diagonal)
    lost |= _parallel(poses) & any(name in _CAMERA for name in choice.names)
    status = jnp.where(lost & (known.status_code <= FitStatus.DIVERGED), FitStatus.RANK_DEFICIENT, known.status_code)
    return report(
        minimum,
        known,
        choice.names,
        lens=model["lens"],
        frame=frame,
        poses=poses,
        per_view_rms=known.per_block_rms,
        status_code=status,
        folds=_folds(model["lens"], frame, size, boards),
        image_size=size,
    )


class Validation(eqx.Module):
    """How well a calibration explains views it has not seen, once their poses are found.

    Attributes:
        poses: The poses of the boards.
        residuals: `(V, N, 2)` in pixels, zero where a corner is missing.
        rms: Root mean square distance over all corners, in pixels.
        per_view_rms: The same for each view.
        status: A `FitStatus` for each view.
    """

    poses: Poses
    residuals: Float[Array, "views corners 2"]
    rms: Float[Array, ""]
    per_view_rms: Float[Array, " views"]
    status: Int[Array, " views"]


@partial(jax.jit, static_argnames="max_steps")
def validate(lens: Lens, frame: Frame, boards: Boards, *, max_steps: int = 200) -> Validation:
    """Validates a calibration on views held out from it: fits only the boards' poses, and reports what is left.

    Args:
        lens: The lens, of a fit on other views.
        frame: The camera, likewise.
        boards: The views held out.
        max_steps: Steps of the solver, for each view.

    Returns:
        A `Validation`. Views with fewer than four corners cannot be judged: their status is `TOO_FEW`.
    """
    dtype = common_dtype(lens, frame, boards)
    lens, frame, boards = in_dtype((lens, frame, boards), dtype)

    def one_view(boards: Boards) -> tuple[Array, Array, Array]:
        problem = _Pose(lens=lens, frame=frame, boards=boards, weights=boards.weights)
        start = Unknowns.dense(_blocks(_start_poses(lens, frame, boards))[0])
        minimum = minimize(problem, start, max_steps=max_steps)
        known = assess(problem, minimum)
        return minimum.unknowns.shared, known.residuals[0], known.status_code

    alone = jax.tree.map(lambda leaf: leaf[:, None], boards)
    vectors, residuals, status = jax.vmap(one_view)(alone)
    enough = jnp.sum(boards.weights > 0, axis=1) >= _CORNERS
    squares = jnp.sum(boards.weights[..., None] * residuals**2, axis=(1, 2))
    weights = jnp.sum(boards.weights, axis=1)
    return Validation(
        _poses(vectors),
        residuals,
        jnp.sqrt(jnp.sum(squares) / jnp.sum(weights)),
        jnp.sqrt(squares / weights),
        jnp.where(enough, status, FitStatus.TOO_FEW),
    )


class _Pose(Problem):
    lens: Lens
    frame: Frame
    boards: Boards
    weights: Float[Array, "1 corners"]

    def residuals(self, unknowns: Unknowns) -> Float[Array, "1 corners 2"]:
        predicted = seen_at(self.lens, self.frame, _poses(unknowns.shared[None]).place(self.boards.points))
        return jnp.where((self.weights > 0)[..., None], self.boards.observed - predicted, 0)


def _start(lens: Lens, boards: Boards, size: Array, camera_matrix: Array | None) -> tuple[Frame, Poses]:
    # A view without corners, of weights that were not known before, starts as another: it must only be finite.
    taken = jnp.sum(boards.weights > 0, axis=1) >= _CORNERS
    boards = boards.view(jnp.where(taken, jnp.arange(taken.shape[0]), jnp.argmax(taken)))
    if camera_matrix is None:
        center = 0.5 * (size - 1)
        if is_wide(lens):
            length, poses = equidistant_start(boards.points, boards.observed, boards.weights, size)
            # The lens may enlarge the middle, as one of a unified camera does.
            enlarged = jnp.trace(jax.jacfwd(lens.distort)(jnp.zeros_like(size))) / 2
            return Frame(center, length / enlarged), poses
        matrices = jax.vmap(direct_linear_transform)(boards.points, boards.observed, boards.weights)
        frame = Frame(center, focal_lengths(matrices, center, jnp.max(size)))
        return frame, poses_from_homographies(matrices, frame)
    frame = Frame.from_camera_matrix(camera_matrix)
    return frame, _start_poses(lens, frame, boards)


def _start_poses(lens: Lens, frame: Frame, boards: Boards) -> Poses:
    if is_wide(lens):
        rays = lens.invert_projection(frame.normalize(boards.observed)).points
        return poses_from_rays(boards.points, rays, boards.weights)
    ideal = frame.denormalize(lens.invert(frame.normalize(boards.observed)).points)
    matrices = jax.vmap(direct_linear_transform)(boards.points, ideal, boards.weights)
    return poses_from_homographies(matrices, frame)


def _poses(blocks: Float[Array, "views 6"]) -> Poses:
    return Poses(blocks[:, :3], blocks[:, 3:])


def _blocks(poses: Poses) -> Float[Array, "views 6"]:
    return jnp.concatenate([poses.rotation_vectors, poses.translations], axis=-1)


def _parallel(poses: Poses) -> Array:
    """Tells whether all boards are parallel to each other: together they then say no more about the camera than one."""
    normals = poses.rotations()[:, :, 2]
    sines = jnp.linalg.norm(jnp.cross(normals[:, None], normals[None]), axis=-1)
    return jnp.max(sines) < _PARALLEL


def _unknown(selection: Selection, minimum: Minimum, known: Knowledge, boards: Boards) -> Float[Array, ""]:
    """Returns how well the camera's projections are known where it saw corners: the root of their mean variance.

    That is what tells whether a calibration is of use. Single parameters do not: through a long lens the principal
    point may be unknown to many pixels, while another rotation of the camera makes up for any of its places.
    """
    model = selection.insert(minimum.unknowns.shared)
    selection = Selection(model, selection.choice)
    every = -(-boards.points.shape[1] // _CORNERS_A_VIEW)
    some = jax.tree.map(lambda leaf: leaf[:, ::every], boards)
    rays = _poses(minimum.unknowns.blocks).place(some.points).reshape(-1, 3)
    weights = some.weights.reshape(-1)
    turns = best_rotation(selection, rays, weights)
    xx, _, yy = covariance_of_pixels(selection, root_of(known.covariance), turns, rays)
    return jnp.sqrt(jnp.sum(jnp.where(weights > 0, xx + yy, 0)) / jnp.sum(weights > 0))


def _folds(lens: Lens, frame: Frame, size: Array, boards: Boards) -> Array:
    """Tells whether some point of the picture's border has no preimage, or one beyond a fold.

    The corners of a fisheye's picture may well show nothing, so that of such a lens it is the corners seen that count.
    """
    if is_wide(lens):
        lost = ~lens.invert_projection(frame.normalize(boards.observed)).valid
        return jnp.any(lost & (boards.weights > 0))
    steps = jnp.linspace(0, 1, 33, dtype=size.dtype)
    zero, one = jnp.zeros_like(steps), jnp.ones_like(steps)
    border = jnp.concatenate(
        [jnp.stack(side, -1) for side in ((steps, zero), (steps, one), (zero, steps), (one, steps))]
    )
    return jnp.any(~lens.invert(frame.normalize(border * (size - 1)[None])).valid)


def _check_views(boards: Boards, choice: Choice, views: int) -> None:
    if not is_concrete(boards):
        return
    corners = (np.asarray(boards.weights) > 0).sum(axis=1)
    for view, count in enumerate(corners):
        if count < _CORNERS:
            raise ValueError(
                f"view {view} has {count} corners; at least {_CORNERS} are needed to find its pose: leave the view out"
            )
    camera = [name for name in choice.names if name in _CAMERA]
    if 2 * views < len(camera):
        raise ValueError(
            f"{views} view of a plane cannot determine {', '.join(camera)}: each view adds two constraints; "
            "give at least "
            f"{-(-len(camera) // 2)} views at different angles (ten are better), or hold some of them fixed"
        )
