"""Where and with what the figures were taken; nothing that names a person, a host or a folder."""

import datetime
import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax

from benchmarks.peers import load

_PACKAGES = (
    "jax",
    "jaxlib",
    "equinox",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "scikit-image",
    "torch",
    "kornia",
    "pytest-benchmark",
)
# What changes speed from outside, should someone have set it.
_VARIABLES = ("XLA_FLAGS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "GLIBC_TUNABLES", "JAX_ENABLE_X64")


def describe(load_before: float) -> dict[str, object]:
    """Returns the machine, its load before the run, versions, threads, commit and date."""
    device = jax.devices()[0]
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="minutes"),
        "commit": commit(),
        "device": "CPU" if device.platform == "cpu" else device.device_kind,
        "cpu": _cpu_model(),
        "cores": _cores(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30),
        "system": f"{platform.system()} {platform.machine()}",
        "load_before": round(load_before, 2),
        "threads": _threads(),
        "set": {name: os.environ[name] for name in _VARIABLES if name in os.environ},
        "versions": {"python": platform.python_version()} | {name: _version(name) for name in _PACKAGES},
    }


def commit() -> str | None:
    """Returns the commit, marked where the library or the benchmarks differ from it."""
    changed = _git("status", "--porcelain", "--", "jaxlens", "benchmarks/*.py")
    found = _git("rev-parse", "--short=12", "HEAD")
    return f"{found} with changes" if found and changed else found


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=10, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def _cores() -> int:
    # Those that the process may use; not every system tells.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _threads() -> dict[str, int]:
    threads = {"XLA": _cores()}  # its pool has one for each core
    if (cv2 := load("cv2")) is not None:
        threads["OpenCV"] = cv2.getNumThreads()
    if (torch := load("torch")) is not None:
        threads["PyTorch"] = torch.get_num_threads()
    return threads


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
