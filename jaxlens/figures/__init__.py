"""What draws, for experiments and the command line: deterministic files, colours that colour-blind people can tell.

The names are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
