"""Experiments: a TOML file in, a folder of tables and figures out, the same bytes every time.

`run` carries one out, `reproduce` all of a folder. The other names are for kinds of experiments: a kind is a Python
file beside the TOML file that defines one subclass of `Experiment`. All are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
