"""What a command says to people: lines on stderr, for stdout is kept for results."""

import contextlib
import sys


def say(message: str) -> None:
    """Writes a line to stderr; above the progress bar, if there is one.

    Args:
        message: For people, without a full stop. Names of files in it are quoted by `repr`, which keeps whatever a
            name may hold from the terminal.
    """
    # Where nobody listens there is nobody to tell about it.
    with contextlib.suppress(OSError, ValueError):
        print(f"jaxlens: {message}", file=sys.stderr)  # noqa: T201
