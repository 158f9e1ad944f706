"""Both contenders' errors, found before either is timed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.peers import Peer


@dataclass(frozen=True)
class Check:
    """How far two contenders are from the truth.

    Attributes:
        what: What was compared, and in which unit.
        ours: Our largest error.
        theirs: The peer's; None without a peer.
        limit: What ours may be at most.
    """

    what: str
    ours: float
    theirs: float | None
    limit: float


def check(
    what: str,
    error: Callable[[np.ndarray], float],
    ours: Callable[[], Any],
    theirs: Peer | None,
    *,
    limit: float,
    peer_limit: float | None = None,
) -> Check:
    """Runs both contenders once and measures their errors.

    Args:
        what: What is compared, and in which unit.
        error: From a result to its error.
        ours: Ours.
        theirs: The peer.
        limit: What our error may be at most.
        peer_limit: What the peer's may be; None where the peer is known to be wrong, and its error only recorded.

    Raises:
        AssertionError: an error beyond its limit: there is nothing to time.
    """
    our_error = error(np.asarray(ours()))
    # Written so that NaN fails too.
    assert our_error <= limit, f"{what}: ours is off by {our_error:.3g}, at most {limit:g} is allowed"
    their_error = None
    if theirs is not None:
        their_error = error(theirs.read(theirs.run()))
        allowed = peer_limit is None or their_error <= peer_limit
        assert allowed, (
            f"{what}: theirs is off by {their_error:.3g}, {peer_limit:g} was expected; is it called rightly?"
        )
    return Check(what, float(our_error), None if their_error is None else float(their_error), limit)


def largest_difference(expected: np.ndarray, where: np.ndarray) -> Callable[[np.ndarray], float]:
    """Returns the error of a picture: its largest difference from the values expected at the pixels of a mask."""
    return lambda result: float(np.max(np.abs(result[where].astype(np.float64) - expected)))
