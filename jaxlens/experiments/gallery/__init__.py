"""The page of all results: figures, tables, parameters and provenance in one file that needs no other."""

from jaxlens.experiments.gallery.page import Section as Section
from jaxlens.experiments.gallery.writing import check_page as check_page
from jaxlens.experiments.gallery.writing import write_page as write_page
