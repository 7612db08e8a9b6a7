"""softdyn: analytic models and controllers for underactuated soft robots.

The names below are imported when they are used, as `__init__.pyi` lists them: the command line
answers `--help` without an engine.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
