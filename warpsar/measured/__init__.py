"""Measured radar data, brought onto the slant-plane grid of a view.

importer: `warpsar import`. gridding: a measurement onto a view's grid. focus: phase history to image. plane: the
same onto a plane grid, fast. ground: where pixels lie. curves: radar cross-sections. chips: many chips and a table
of their angles, in one call, and which of them are held back.
response: the width of the response that a header declares, as `[effects.point_spread]`. placed: where a scene lies on
a map.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
