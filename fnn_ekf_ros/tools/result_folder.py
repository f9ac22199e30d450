"""Where results go."""

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
