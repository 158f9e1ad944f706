"""What can go wrong with an experiment, with messages that are ready for people."""


class ConfigError(ValueError):
    """The configuration, or what was asked of it, is wrong; the message names file, key, value, and what is allowed."""


class ExperimentError(RuntimeError):
    """The experiment could not be carried out, or its results not be put where they belong."""
