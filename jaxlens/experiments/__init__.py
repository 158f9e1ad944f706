"""Experiments: a TOML file in, a folder of tables and figures out, the same bytes every time."""

from jaxlens.experiments.errors import ConfigError as ConfigError
from jaxlens.experiments.errors import ExperimentError as ExperimentError
from jaxlens.experiments.reproduction import Reproduction as Reproduction
from jaxlens.experiments.reproduction import Step as Step
from jaxlens.experiments.reproduction import reproduce as reproduce
from jaxlens.experiments.runner import Report as Report
from jaxlens.experiments.runner import run as run
