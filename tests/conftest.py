"""What all tests share: strict broadcasting, and both precisions without a global switch."""

import os

import jax
import pytest

# Nearly all the time is compilation: code that runs once need not be optimized, and the older of the two generators of
# fused loops compiles three times as fast. Read when the first array is made.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false")


@pytest.fixture(autouse=True)
def _strict_rank_promotion():
    """Makes accidental broadcasting an error."""
    with jax.numpy_rank_promotion("raise"):
        yield


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
