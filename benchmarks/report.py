"""The tables: from pytest-benchmark's report to the few numbers kept, and from those to README.md."""

from collections.abc import Iterable, Iterator

from benchmarks.material import BROWN_CONRADY, CHANNELS, SIZE

_COEFFICIENTS = ", ".join(f"{value:g}" for value in BROWN_CONRADY[:8]).replace("-", "−")
_HEADER = f"""\
# Benchmarks

Written by a command; do not edit. To take the figures again (some six minutes, on an otherwise idle machine), from
the repository's root:

    pip install '.[bench]'            # '.[bench-torch]' for the rows of PyTorch and kornia
    python -m benchmarks              # this file and results-<device>.json; --help says more
    pytest benchmarks                 # pytest-benchmark's own table; --benchmark-disable only checks

A row is a function in `bench_*.py`, and its name is its key in the JSON. Unless a row says otherwise an image is
{SIZE}×{SIZE}×{CHANNELS} float32, and the lens is OpenCV's (`BrownConrady`) with 5 of the coefficients
{_COEFFICIENTS}, the focal length half the diagonal, which
is Eq. 10's unit. *2 coefficients* are the paper's lens (`RadialPolynomial`), 8 have the denominator as well, 14 the
thin prism and the tilted sensor.

- *Lens to picture*: the lens object is built and the map computed in every call; only the compiled function is warm.
  So it is for the peers. *Ready map*: the source coordinates are there.
- Both contenders are checked against a float64 reference before they are timed (last table).
- They take turns, round by round, with the machine's load shared: a rest of 10 ms, an untimed call (unless a call takes
  over 100 ms), the timed call. Each waits for its result and releases it within the time; each keeps its default
  number of threads and finds its inputs in its own kind of array.
- *Ratio* is ours over theirs, of the medians; *by round* is the median of the rounds' own ratios, with quartiles.
- *Floor*: the time of a compiled copy of as many bytes as the work must move (inputs read, outputs written), measured
  in the same rounds.
"""


def summarize(report: dict) -> dict:
    """Returns what is kept of pytest-benchmark's report: where it ran, and a few numbers a row."""
    rows = [{"key": found["name"]} | _rounded(found["extra_info"]) for found in report["benchmarks"]]
    return {"environment": report["environment"], "rows": rows}


def render(runs: Iterable[dict]) -> str:
    """Returns README.md for the results of one or more devices."""
    return "\n".join([_HEADER, *("\n".join(_run(run)) for run in runs)])


def _run(run: dict) -> Iterator[str]:
    environment, rows = run["environment"], run["rows"]
    on_cpu = environment["device"] == "CPU"
    yield f"## {'CPU' if on_cpu else environment['device']}\n"
    yield from _environment(environment)
    targets = [row for row in rows if row["target"] is not None]
    if targets:
        yield from _timings("Against the targets", targets, on_cpu)
    others = [row for row in rows if row["target"] is None]
    if others:
        yield from _timings("Beyond the targets", others, on_cpu)
    yield "### How far from the floor\n"
    yield from _table(
        ("work", "moved, MB", "floor, ms", "ours, ms", "ours / floor"),
        (
            (
                row["work"],
                f"{row['moved_mb']:.1f}",
                _number(row["floor_ms"]),
                _number(row["ours_ms"]),
                f"{row['ours_ms'] / row['floor_ms']:.1f}",
            )
            for row in _once(rows)
        ),
        "lrrrr",
    )
    yield "### What was checked before\n"
    yield from _table(
        ("work", "against", "error", "ours", "allowed", "theirs"),
        (
            (
                row["work"],
                row["against"],
                found["what"],
                f"{found['ours']:.2g}",
                f"{found['limit']:g}",
                "" if found["theirs"] is None else f"{found['theirs']:.2g}",
            )
            for row in rows
            for found in row["checks"]
        ),
        "lllrrr",
    )


def _once(rows: list[dict]) -> list[dict]:
    """The first row of each work: against another peer the same was done again."""
    first: dict[str, dict] = {}
    for row in rows:
        first.setdefault(row["work"], row)
    return list(first.values())


def _environment(environment: dict) -> Iterator[str]:
    versions = ", ".join(f"{name} {number or 'not installed'}" for name, number in environment["versions"].items())
    threads = ", ".join(f"{name} {count}" for name, count in environment["threads"].items())
    machine = f"{environment['cpu']}, {environment['cores']} cores, {environment['memory_gib']} GiB"
    yield f"- {machine}, {environment['system']}"
    yield f"- threads: {threads}"
    if environment["set"]:
        yield "- set from outside: " + ", ".join(f"`{name}={value}`" for name, value in environment["set"].items())
    yield f"- {versions}"
    yield f"- commit {environment['commit'] or 'unknown'}, {environment['date']}"
    load, cores = environment["load_before"], environment["cores"]
    # OpenMP's threads wait for each other: robbed of one core, PyTorch takes ten times as long.
    warning = "; **the machine was busy: the figures are noisy, PyTorch's and Kornia's far too high**"
    busy = warning if load > cores / 4 else ""
    yield f"- load before the run: {load:.1f}{busy}\n"


def _timings(title: str, rows: list[dict], on_cpu: bool) -> Iterator[str]:
    yield f"### {title}\n"
    heads = ("work", "against", "ours, ms", "theirs, ms", "ratio", "by round", "rounds")
    judged = any(row["target"] is not None for row in rows)
    yield from _table(
        (*heads, "at most", "met") if judged else heads,
        ((*_timing(row, on_cpu), *(_verdict(row) if judged else ())) for row in rows),
        "llrrrrrrl"[: 9 if judged else 7],
    )


def _timing(row: dict, on_cpu: bool) -> tuple[str, ...]:
    theirs = "" if row["package"] is None else f"{row['package']} is not installed"
    ratio = paired = ""
    if row["theirs_ms"] is not None:
        low, middle, high = row["paired"]
        theirs, ratio = _number(row["theirs_ms"]), f"{row['ratio']:.3g}"
        paired = f"{middle:.3g} ({low:.3g}–{high:.3g})"
    against = row["against"] if on_cpu or row["theirs_ms"] is None else f"{row['against']}, on {row['device']}"
    return row["work"], against, _number(row["ours_ms"]), theirs, ratio, paired, str(row["rounds"])


def _verdict(row: dict) -> tuple[str, str]:
    if row["ratio"] is None:
        return f"{row['target']:g}", "not measured"
    return f"{row['target']:g}", "yes" if row["ratio"] <= row["target"] else "**no**"


def _table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]], alignment: str) -> Iterator[str]:
    yield "| " + " | ".join(heads) + " |"
    yield "|" + "|".join({"l": "---", "r": "---:"}[side] for side in alignment) + "|"
    for row in rows:
        yield "| " + " | ".join(row) + " |"
    yield ""


def _number(milliseconds: float) -> str:
    return f"{milliseconds:.3g}" if milliseconds < 100 else f"{milliseconds:.0f}"


def _rounded(value):
    """Keeps four digits: more would only make every run differ."""
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_rounded(inner) for inner in value]
    return value
