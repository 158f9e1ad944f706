"""What all tests share: quick compilation, strict broadcasting, and both precisions without a global switch."""

import atexit
import os
import shutil
import subprocess
import sys
import tempfile

import jax
import jaxtyping
import pytest


def _is_known(flag):
    """Whether XLA starts with this flag: it ends the process at one that it does not know, and lists none."""
    environment = os.environ | {"XLA_FLAGS": flag, "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", "import jax; jax.devices()"]
    return subprocess.run(command, env=environment, capture_output=True).returncode == 0


# Nearly all the time is compilation: code that runs once need not be optimized, and the older of the two generators of
# fused loops, where there still are two, compiles three times as fast. Parts of a program, compiled side by side, take
# longer in sum, and the workers of pytest-xdist keep the cores busy. Read when the first array is made; the workers
# inherit what the first process found. XLA_FLAGS= (empty) tests what users run.
if "XLA_FLAGS" not in os.environ:
    flags = (
        "--xla_backend_optimization_level=0",
        "--xla_cpu_use_fusion_emitters=false",
        "--xla_cpu_parallel_codegen_split_count=1",
    )
    os.environ["XLA_FLAGS"] = " ".join(flag for flag in flags if _is_known(flag))

# Many programs are those of another test, worker or command line: one folder keeps them all, for this run alone.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    folder = tempfile.mkdtemp(prefix="jaxlens-tests-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    settings = {
        "jax_compilation_cache_dir": folder,
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    for name, value in settings.items():
        jax.config.update(name, value)  # this process has imported JAX already
        os.environ[name.upper()] = str(value)


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


@pytest.fixture
def untyped():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
