"""What happens between a surface and a pixel, beside single-bounce scattering: docs/effects.md.

Each effect is one file here, with its kernels in `warpsar.kernels.effects`. `base/` says what an effect is, and
`registry.py` finds effects by name. docs/add-an-effect.md shows how to write one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
