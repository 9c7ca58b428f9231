"""What a sensor records on its track: phase history, and the complex images that come from it.

presets: published systems. track_file: where the sensor is at each pulse, from CSV and CPHD. antenna_file: a measured
pattern. plan: band, track and system of a view, checked. response: widths and cells of a system. scatterers: what sends
back, from the coherent engine. places: the same of one direction. bodies: the mesh
on the device, kept from view to view. history: phase history. slc: complex images, and focusing. direct: each scatterer
times the response. noise: of the receiver. forecast: time and
memory, measured on parts of the work. command: `warpsar simulate --product`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
