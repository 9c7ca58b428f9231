"""From a scene to the images of its views, and `warpsar simulate`.

rays: a scene's views traced. exact_rays: the same without rays. sampling: how many rays are enough.
command: one scene's images and files. outputs: the JSON that every command writes.
batch: many images in one command. naming: their views and names.
maker: one scene of a batch. index: what is there already.
checks: what a user should be told. estimate: how long it will take.
view: one view, simulated. strong_scatterers: what is bright in it, listed. speckle: speckle on images.
ground: images on a map. dataset: views through xarray.
files: the files of a view. formats/: one file for each format. image_format: what a format declares.
materials: `warpsar materials`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
