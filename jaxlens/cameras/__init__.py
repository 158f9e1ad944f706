"""Cameras: a lens, its frame and the size of its pictures; what one has seen as another would have seen it."""

from jaxlens.cameras._camera import Camera as Camera
from jaxlens.cameras._reprojection import reproject as reproject
from jaxlens.cameras._sight import sight as sight
from jaxlens.cameras._views import Keep as Keep
from jaxlens.cameras._views import ViewProjection as ViewProjection
from jaxlens.cameras._views import check_view as check_view
