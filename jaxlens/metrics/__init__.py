"""Quality of an image against a reference: error norms, decibels and structural similarity (Section 2.5)."""

from jaxlens.metrics.pointwise import mae as mae
from jaxlens.metrics.pointwise import minkowski as minkowski
from jaxlens.metrics.pointwise import mse as mse
from jaxlens.metrics.pointwise import psnr as psnr
from jaxlens.metrics.pointwise import range_snr as range_snr
from jaxlens.metrics.pointwise import rmse as rmse
from jaxlens.metrics.pointwise import snr as snr
from jaxlens.metrics.strips import evaluate_in_strips as evaluate_in_strips
from jaxlens.metrics.structural import QualityFactors as QualityFactors
from jaxlens.metrics.structural import ssim as ssim
from jaxlens.metrics.structural import uqi as uqi
from jaxlens.metrics.structural import uqi_components as uqi_components
from jaxlens.metrics.summary import evaluate as evaluate
from jaxlens.metrics.table import METRICS as METRICS
from jaxlens.metrics.table import Metric as Metric
from jaxlens.metrics.totals import Totals as Totals
