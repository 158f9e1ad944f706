"""The fixture that times a row, and what the run adds to pytest-benchmark's report."""

import os

import pytest

from benchmarks.environment import describe
from benchmarks.race import Race

_LOAD = pytest.StashKey[float]()


def pytest_configure(config):
    config.stash[_LOAD] = os.getloadavg()[0]


def pytest_addoption(parser):
    parser.addoption("--row-seconds", type=float, default=3.0, help="how long to time each row (default: 3)")


@pytest.fixture
def race(benchmark, request):
    """Times a row once its contenders are checked, see `Race`."""
    row = request.node.get_closest_marker("row")
    # What the row is run with may stand in its text.
    work = row.args[0].format(**request.node.callspec.params) if hasattr(request.node, "callspec") else row.args[0]
    return Race(benchmark, {"work": work, "target": None} | row.kwargs, request.config.getoption("row_seconds"))


def pytest_benchmark_update_json(config, benchmarks, output_json):
    """Adds what pytest-benchmark does not know."""
    output_json["environment"] = describe(config.stash[_LOAD])
