"""Ours and theirs in turns, round by round, so that whatever else the machine does hits both."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.checks import Check
from benchmarks.peers import Peer

# Long enough for the threads of the one before to fall asleep: OpenCV's spin for some 2 ms after their work is done.
_REST = 0.01
# A call as long as this need not be preceded by another that warms its threads and its part of the cache.
_LONG = 0.1
_WARMUP = 3
_FEWEST_ROUNDS, _LEAST_ROUNDS, _MOST_ROUNDS = 5, 15, 301
# Rounds longer than this, in seconds, are made only so often as the fewest.
_SLOW = 0.5


class Race:
    """Times one row of the table.

    Args:
        benchmark: pytest-benchmark's fixture, which times ours; the peer has its turn in the setup of each round.
        row: What the row says of itself: `work`, `against`, `target`.
        seconds: How long to go on.
    """

    def __init__(self, benchmark: Any, row: dict[str, object], seconds: float):
        self.benchmark, self.row, self.seconds = benchmark, row, seconds

    def __call__(
        self,
        ours: Callable[[], Any],
        theirs: Peer | None,
        *,
        package: str | None,
        checks: Sequence[Check],
        moved: int,
        per: int = 1,
    ) -> None:
        """Times a pair that has been checked.

        Each turn is a rest, an untimed call (unless it is long), and the timed call, the release of its result
        included. Turns go theirs, copy, ours, and again; the copy is a compiled one of as many bytes as the work must
        move, so its time is the floor.

        Args:
            ours: Ours, compiled or to be compiled by its first call; it need not wait for its result.
            theirs: The peer; None if it is not installed.
            package: The peer's name; None where ours runs alone.
            checks: What was found before.
            moved: Bytes of inputs read and outputs written, as few as the work allows.
            per: How many times the peer's work a call of ours does; the times are for once.
        """
        run_ours = _finished(ours)
        if self.benchmark.disabled:  # --benchmark-disable: only the checks were wanted
            self.benchmark.pedantic(run_ours)
            return
        run_theirs = None if theirs is None else _discarded(theirs.run)
        run_copy = _copy_of(moved)
        turns = [run for run in (run_theirs, run_copy, run_ours) if run is not None]
        for run in turns:
            run()
        long = {run: _duration(run) > _LONG for run in turns}
        for run in [run for run in turns if not long[run]] * _WARMUP:
            run()
        began = time.perf_counter()
        for run in turns:
            _turn(run, long[run])
        estimate = time.perf_counter() - began
        least = _FEWEST_ROUNDS if estimate > _SLOW else _LEAST_ROUNDS
        rounds = min(max(int(self.seconds / estimate), least), _MOST_ROUNDS)

        their_times: list[float] = []
        copy_times: list[float] = []

        def before_ours() -> None:
            if run_theirs is not None:
                their_times.append(_turn(run_theirs, long[run_theirs]))
            copy_times.append(_turn(run_copy, long[run_copy]))
            _prepare(run_ours, long[run_ours])

        self.benchmark.pedantic(run_ours, setup=before_ours, rounds=rounds, warmup_rounds=1)
        our_times = [seconds / per for seconds in self.benchmark.stats.stats.data]
        their_times = their_times[-rounds:]
        copy_times = [seconds / per for seconds in copy_times[-rounds:]]
        self.benchmark.extra_info.update(
            self.row,
            package=package,
            device="CPU" if theirs is None else theirs.device,
            checks=[asdict(found) for found in checks],
            rounds=rounds,
            ours_ms=_milliseconds(our_times),
            theirs_ms=_milliseconds(their_times),
            floor_ms=_milliseconds(copy_times),
            moved_mb=moved / per / 1e6,
            **_ratios(our_times, their_times),
        )


def _ratios(our_times: list[float], their_times: list[float]) -> dict[str, object]:
    if not their_times:
        return {"ratio": None, "paired": None}
    paired = [a / b for a, b in zip(our_times, their_times, strict=True)]
    return {
        "ratio": statistics.median(our_times) / statistics.median(their_times),
        "paired": statistics.quantiles(paired, n=4, method="inclusive"),
    }


def _milliseconds(times: list[float]) -> float | None:
    return 1e3 * statistics.median(times) if times else None


def _finished(start: Callable[[], Any]) -> Callable[[], None]:
    def run() -> None:
        jax.block_until_ready(start())

    return run


def _discarded(start: Callable[[], Any]) -> Callable[[], None]:
    def run() -> None:
        start()

    return run


def _copy_of(moved: int) -> Callable[[], None]:
    # Half of the bytes are read, half are written.
    source = jnp.ones(moved // 8, jnp.float32)
    # Compiled ahead: a row may clear the caches.
    copy = jax.jit(jnp.copy).lower(source).compile()
    return _finished(lambda: copy(source))


def _turn(run: Callable[[], None], long: bool) -> float:
    _prepare(run, long)
    return _duration(run)


def _prepare(run: Callable[[], None], long: bool) -> None:
    time.sleep(_REST)
    if not long:
        run()


def _duration(run: Callable[[], None]) -> float:
    began = time.perf_counter()
    run()
    return time.perf_counter() - began
