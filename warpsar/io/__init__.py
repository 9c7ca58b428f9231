"""Files in and out, apart from scene files, meshes and measured formats.

images: TIFF, EXR, NPY and PNG. curves: radar cross-sections as text. tiff, geotiff: checks and opening of TIFF
files. ply: meshes with scalars. checkpoint: a run's state. figures: PNGs through matplotlib.
grey_scale: how powers become greys. quick_look: images in dB, with axes.
html, html_image: the parts of a report. assets: its style and script.
bands: rasters larger than memory, by bands of rows.
complex_image: complex images in NPZ. input_file: text and bytes of files that users name, bounded.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
