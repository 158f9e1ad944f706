"""The manifest: what was run, on what, and the checksums of what came out; and the record of the run itself.

The same experiment gives the same manifest, byte for byte, wherever and whenever it is run.
"""

import datetime
import json
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from jaxlens.experiments.config import Configuration
from jaxlens.experiments.errors import ExperimentError
from jaxlens.experiments.folders import MANIFEST, MARKER, RECORD
from jaxlens.files import file_sha256

SCHEMA = 2
_PACKAGES = ("jaxlens", "jax", "jaxlib", "equinox", "optimistix", "numpy", "matplotlib", "pillow")


def write_manifest(
    folder: Path,
    configuration: Configuration,
    *,
    input_files: dict[str, str],
    inputs: list[dict[str, object]],
    facts: dict[str, object],
) -> dict[str, object]:
    """Writes `manifest.json` for the files of a folder, and returns what it says.

    Args:
        folder: The results, complete but for the manifest.
        configuration: The experiment.
        input_files: As `input_checksums` found them before the experiment read them.
        inputs: Facts on each image.
        facts: What else the experiment has to say.
    """
    manifest: dict[str, object] = {
        "tool": MARKER,
        "schema": SCHEMA,
        "experiment": configuration.experiment.name,
        "configuration": configuration.experiment.as_dict(),
        "configuration_file": configuration.path.name,
        "configuration_sha256": configuration.digest(),
        "input_files": input_files,
        "inputs": inputs,
        "results": facts,
        "dtype": configuration.experiment.dtype,
        "seed": configuration.experiment.seed,
        "files": {path.name: file_sha256(path) for path in sorted(folder.iterdir())},
    }
    _write(folder / MANIFEST, manifest)
    return manifest


def write_record(folder: Path, configuration: Configuration, *, seconds: float) -> dict[str, object]:
    """Writes `run.json` for a folder with its manifest, and returns what it says.

    Args:
        folder: The results.
        configuration: The experiment.
        seconds: How long it took.
    """
    record: dict[str, object] = {
        "manifest_sha256": file_sha256(folder / MANIFEST),
        "commit": _commit(configuration),
        "sources": configuration.kind.sources(),
        "versions": {"python": platform.python_version()} | package_versions(),
        "device": _device(),
        "platform": f"{platform.system()} {platform.machine()}",
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "seconds": round(seconds, 3),
    }
    _write(folder / RECORD, record)
    return record


def _write(path: Path, content: dict[str, object]) -> None:
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    path.write_text(text, encoding="utf-8", newline="")


def input_checksums(configuration: Configuration) -> dict[str, str]:
    """Returns the SHA-256 of each file that an experiment reads, by the key that names it.

    Raises:
        ExperimentError: a file cannot be read.
    """
    try:
        return {key: file_sha256(path) for key, path in configuration.input_files().items()}
    except OSError as error:
        raise ExperimentError(f"cannot read {error.filename!r}: {error.strerror}") from error


def package_versions() -> dict[str, str | None]:
    """Returns the versions of the packages that results may depend on."""
    return {name: _version(name) for name in _PACKAGES}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _device() -> str:
    import jax

    device = jax.devices()[0]
    return device.platform if device.platform == "cpu" else f"{device.platform}: {device.device_kind}"


def _commit(configuration: Configuration) -> str | None:
    """The commit of the library where it is run from a checkout, else that of the configuration."""
    package = Path(__file__).parents[1]
    return _commit_of(package / "__init__.py", package) or _commit_of(configuration.path, configuration.path.parent)


def _commit_of(file: Path, folder: Path) -> str | None:
    """The commit that a file belongs to, marked if anything in the folder differs from it; None if untracked."""
    if _git(folder, "ls-files", "--error-unmatch", "--", str(file.absolute())) is None:
        return None
    commit = _git(folder, "rev-parse", "HEAD")
    changes = _git(folder, "status", "--porcelain", "--", ".")
    return commit if not commit or not changes else f"{commit}-dirty"


def _git(folder: Path, *arguments: str) -> str | None:
    command = ["git", "-C", str(folder.absolute()), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
