"""What should a product show of the ground that an elevation model gives? The command `twin`.

elevation.py     an elevation model: read in windows, to heights above the ellipsoid, placed on the earth
landcover.py     classes of land cover become surfaces of the library
buildings.py     buildings on the elevation model
scenery.py       surfaces, land cover and buildings together
blocks.py        a product's window in blocks of bounded size
ground.py        the facets of a block, in lines and slant ranges
projection.py    facets into pixels and cells of the map, on the device
memory.py        how much memory and disk it takes, before the work
layers.py        what each layer is: name, unit, words
result.py        a product's layers together
summary.py       what they say in a few numbers and words
comparison.py    measured pixels beside simulated ones, and rivals that know no terrain
scatter.py       how cells scatter about a model, and what neighbours have in common
parts.py         cells of one declared surface that are off together
differences.py   what differs between them, as hypotheses with intervals
files.py         GeoTIFF, NetCDF and Zarr
figures.py       pictures with axes
command.py       all of it, and report.html
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
