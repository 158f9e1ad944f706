"""Lens models, one file a family."""

from jaxlens.lenses._brown_conrady import BrownConrady as BrownConrady
from jaxlens.lenses._division import Division as Division
from jaxlens.lenses._lens import Lens as Lens
from jaxlens.lenses._lens import RadialLens as RadialLens
from jaxlens.lenses._lens import as_center as as_center
from jaxlens.lenses._radial_polynomial import RadialPolynomial as RadialPolynomial
from jaxlens.lenses._registry import find_lens as find_lens
from jaxlens.lenses._registry import register as register
from jaxlens.lenses._registry import registered as registered
from jaxlens.lenses._registry import registered_name as registered_name
