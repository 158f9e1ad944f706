"""Quality of an image against a reference: error norms, decibels and structural similarity (Section 2.5).

All metrics share these rules:

- The reference x comes first and the image y second, both `(H, W)` or `(H, W, C)` of any real dtype.
  Integers and booleans are compared as floats (float64 under x64, else float32), half precision as float32.
- A colour image counts as H·W·C samples: the mean is over all channels, as the paper says below Eq. 8.
- `mask` is boolean `(H, W)`, True where a pixel counts. What it hides may be anything, NaN too. A mask that
  counts no pixel gives NaN. A NaN that counts gives NaN.
- Shapes that do not fit raise `ValueError`. Numbers such as `data_range` do so when they are known; a traced
  one that is out of bounds gives NaN instead.
- All are differentiable in both images, forward and in reverse. Where a metric has a kink or is infinite, its
  derivative there is 0; the docstrings say where that is.
"""

from jaxlens.metrics._inputs import Pair as Pair
from jaxlens.metrics._inputs import check_images as check_images
from jaxlens.metrics._inputs import pair as pair
from jaxlens.metrics._pointwise import mae as mae
from jaxlens.metrics._pointwise import minkowski as minkowski
from jaxlens.metrics._pointwise import mse as mse
from jaxlens.metrics._pointwise import psnr as psnr
from jaxlens.metrics._pointwise import range_snr as range_snr
from jaxlens.metrics._pointwise import rmse as rmse
from jaxlens.metrics._pointwise import snr as snr
from jaxlens.metrics._strips import evaluate_in_strips as evaluate_in_strips
from jaxlens.metrics._structural import QualityFactors as QualityFactors
from jaxlens.metrics._structural import ssim as ssim
from jaxlens.metrics._structural import uqi as uqi
from jaxlens.metrics._structural import uqi_components as uqi_components
from jaxlens.metrics._summary import evaluate as evaluate
from jaxlens.metrics._table import METRICS as METRICS
from jaxlens.metrics._table import Metric as Metric
from jaxlens.metrics._totals import Totals as Totals
