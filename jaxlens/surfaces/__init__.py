"""Surfaces: depth maps and meshes, a face among them; shading, deformation, distances along the surface."""

from jaxlens.surfaces._deform import DeformedDepthMap as DeformedDepthMap
from jaxlens.surfaces._deform import DeformedMesh as DeformedMesh
from jaxlens.surfaces._deform import deform_depth_map as deform_depth_map
from jaxlens.surfaces._deform import deform_mesh as deform_mesh
from jaxlens.surfaces._depth_map import DepthMap as DepthMap
from jaxlens.surfaces._face import FaceShape as FaceShape
from jaxlens.surfaces._face import face as face
from jaxlens.surfaces._face import face_albedo as face_albedo
from jaxlens.surfaces._from_mesh import from_mesh as from_mesh
from jaxlens.surfaces._geodesic import geodesic_distance as geodesic_distance
from jaxlens.surfaces._geodesic_path import GeodesicPath as GeodesicPath
from jaxlens.surfaces._geodesic_path import geodesic_path as geodesic_path
from jaxlens.surfaces._mesh import Mesh as Mesh
from jaxlens.surfaces._mesh_normals import normals_from_mesh as normals_from_mesh
from jaxlens.surfaces._nose_tip import nose_tip as nose_tip
from jaxlens.surfaces._radial import radial_geodesic_distance as radial_geodesic_distance
from jaxlens.surfaces._shading import normals as normals
from jaxlens.surfaces._shading import shade as shade
