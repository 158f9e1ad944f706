"""The command line: one file a command, and nothing heavy imported before the arguments are good."""

from jaxlens.cli.entry import main as main
