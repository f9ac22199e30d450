"""What made a result, and where results go."""

import importlib.metadata
import subprocess
from pathlib import Path

from fnn_ekf_ros.errors import FnnEkfError


def make_folder(path: Path) -> None:
    """Make the folder of `--out` if it is not there.

    Raises:
        FnnEkfError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FnnEkfError(f"--out '{path}': {error.strerror}") from None


def version() -> str:
    """Return the package's version; in a clone the commit too."""
    try:
        installed = importlib.metadata.version("fnn_ekf_ros")
    except importlib.metadata.PackageNotFoundError:
        installed = "not installed"
    clone = Path(__file__).resolve().parents[2]
    if not (clone / ".git").exists():
        return installed
    command = ["git", "-C", str(clone), "describe", "--always", "--dirty"]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    except (OSError, subprocess.CalledProcessError):
        return installed
    return f"{installed}, commit {said.stdout.strip()}"
