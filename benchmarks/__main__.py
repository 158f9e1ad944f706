"""`python -m benchmarks`: runs the benchmarks, and writes `results-<device>.json` and README.md beside this file."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import tyro

from benchmarks.report import render, summarize

_FOLDER = Path(__file__).parent


def main(*, select: str = "", row_seconds: float = 3.0, render_only: bool = False) -> int:
    """Runs the benchmarks, ours and the peers' in one process, and writes the tables.

    Args:
        select: Only rows whose names match, as in `pytest -k`; the table is then printed, and nothing is written.
        row_seconds: How long to time each row; at least 15 rounds are made.
        render_only: Write README.md again from the results that are there.
    """
    if not render_only:
        results = _run(select, row_seconds)
        if results is None:
            return 1
        if select:
            sys.stdout.write(render([results]))
            return 0
        platform = "cpu" if results["environment"]["device"] == "CPU" else "gpu"
        text = json.dumps(results, indent=1, ensure_ascii=False) + "\n"
        (_FOLDER / f"results-{platform}.json").write_text(text, encoding="utf-8")
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(_FOLDER.glob("results-*.json"))]
    (_FOLDER / "README.md").write_text(render(runs), encoding="utf-8")
    return 0


def _run(select: str, row_seconds: float) -> dict | None:
    """The results of a run, None if a row failed."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pytest", str(_FOLDER), f"--benchmark-json={report}"]
        command += [f"--row-seconds={row_seconds}", *(["-k", select] if select else [])]
        if subprocess.run(command, cwd=_FOLDER.parent, check=False).returncode:
            return None
        return summarize(json.loads(report.read_text(encoding="utf-8")))


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
