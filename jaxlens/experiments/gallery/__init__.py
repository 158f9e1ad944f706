"""The page of all results: figures, tables, parameters and provenance."""

from jaxlens.experiments.gallery.page import check_page as check_page
from jaxlens.experiments.gallery.page import write_page as write_page
from jaxlens.experiments.gallery.sections import Section as Section
