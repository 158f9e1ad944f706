"""What all tests share: quick compilation, strict broadcasting, and both precisions without a global switch."""

import os
import subprocess
import sys

import jax
import pytest


def _is_known(flag):
    """Whether XLA starts with this flag: it ends the process at one that it does not know, and lists none."""
    environment = os.environ | {"XLA_FLAGS": flag, "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", "import jax; jax.devices()"]
    return subprocess.run(command, env=environment, capture_output=True).returncode == 0


# Nearly all the time is compilation: code that runs once need not be optimized, and the older of the two generators of
# fused loops, where there still are two, compiles three times as fast. Read when the first array is made; the workers
# of pytest-xdist inherit what the first process found. XLA_FLAGS= (empty) tests what users run.
if "XLA_FLAGS" not in os.environ:
    flags = ("--xla_backend_optimization_level=0", "--xla_cpu_use_fusion_emitters=false")
    os.environ["XLA_FLAGS"] = " ".join(flag for flag in flags if _is_known(flag))


@pytest.fixture(autouse=True)
def _strict_rank_promotion():
    """Makes accidental broadcasting an error."""
    with jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled_code():
    """Keeps a process from growing: the code that one module compiled is seldom of use to the next."""
    yield
    jax.clear_caches()


@pytest.fixture
def x64():
    """Runs a test in double precision."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(params=["float32", "float64"])
def dtype(request):
    """Runs a test in both precisions, and tells which."""
    with jax.enable_x64(request.param == "float64"):
        yield request.param
