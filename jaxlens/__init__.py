"""Lens distortion in JAX: exact inverses with a validity mask, implicit gradients, batches, speed.

The public names stand in `__init__.pyi` and are imported when they are first used, so that `jaxlens --help` need not
wait for JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
