"""What each kind of experiment does: compute, write its files into a folder, and say what came out."""

from jaxlens.experiments.kinds.dispatch import Outcome as Outcome
from jaxlens.experiments.kinds.dispatch import perform as perform
