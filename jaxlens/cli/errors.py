"""What ends a command early, with a message for people in place of a traceback."""

import os

_OUT_OF_MEMORY = ("RESOURCE_EXHAUSTED", "out of memory")


class CommandError(Exception):
    """The work could not be done: a damaged file, a full disk. The message says what failed and what to do."""

    exit_code = 1


class UsageError(CommandError):
    """The arguments ask for something that cannot be; nothing was begun."""

    exit_code = 2


def describe_unexpected(error: Exception) -> str:
    """Returns what to say of an exception that no command foresaw."""
    # XLA's exhaustion of memory is a RuntimeError with a word in it.
    if isinstance(error, MemoryError) or any(sign in str(error) for sign in _OUT_OF_MEMORY):
        return "not enough memory; try a smaller picture"
    return (
        f"unexpected {type(error).__name__}: {error}\n"
        "This is a fault of jaxlens. Please report what it prints when run again with JAXLENS_TRACEBACK=1."
    )


def wants_traceback() -> bool:
    """Whether the user asks, by JAXLENS_TRACEBACK, to see tracebacks of unexpected exceptions."""
    return bool(os.environ.get("JAXLENS_TRACEBACK"))
