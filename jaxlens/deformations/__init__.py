"""Deformations of the plane and of space: free-form lattices, B-spline fields and homographies."""

from jaxlens.deformations._bspline import BSplineField as BSplineField
from jaxlens.deformations._bspline_fit import fit_bspline_field as fit_bspline_field
from jaxlens.deformations._dlt import direct_linear_transform as direct_linear_transform
from jaxlens.deformations._estimation import EstimateStatus as EstimateStatus
from jaxlens.deformations._estimation import HomographyEstimate as HomographyEstimate
from jaxlens.deformations._estimation import estimate_homography as estimate_homography
from jaxlens.deformations._freeform import FreeForm as FreeForm
from jaxlens.deformations._freeform3d import FreeForm3D as FreeForm3D
from jaxlens.deformations._freeform3d import Inverse3D as Inverse3D
from jaxlens.deformations._homography import Homography as Homography
from jaxlens.deformations._rectification import rectification as rectification
