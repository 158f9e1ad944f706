"""Deformations: free-form lattices, B-spline fields and homographies, as coordinate maps."""

from jaxlens.deformations._freeform import FreeForm as FreeForm
from jaxlens.deformations._freeform3d import FreeForm3D as FreeForm3D
from jaxlens.deformations._freeform3d import Inverse3D as Inverse3D
from jaxlens.deformations._bspline import BSplineField as BSplineField
from jaxlens.deformations._bspline_fit import fit_bspline_field as fit_bspline_field
