"""What ends a command early, with a message for people in place of a traceback."""


class CommandError(Exception):
    """The work could not be done: a damaged file, a full disk. The message says what failed and what to do."""

    exit_code = 1


class UsageError(CommandError):
    """The arguments ask for something that cannot be; nothing was begun."""

    exit_code = 2
