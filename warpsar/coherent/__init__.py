"""What does a body send back, with its phase?

| file | what it holds |
|---|---|
| `joints.py` | which faces meet at which edge, also where a mesh is not welded |
| `shape.py` | smooth surfaces with their normals, flat regions with their borders, wedges with their outer angles |
| `patches.py` | the scatterers of rough faces, placed in any parts where they are needed |
| `rough.py` | the parameters of rough faces |
| `rough_models.py` | which scatterers have a model beside `ka_spm`, and what their kernels look up |
| `plates.py` | the rims of thin plates, which waves go between |
| `wedge.py` | what the edge of an endless wedge adds to physical optics |
| `records.py` | arrays of a kernel's structs, filled on the host |
| `body.py` | a shape and its materials on a device |
| `forecast.py` | time and memory of a sweep, measured on parts of it |
| `rays.py` | the rays of a direction, and the parts of those that get too wide |
| `traced.py` | tubes on a device: traced, cut, and what they radiate, summed up for each direction |
| `sweep.py` | amplitudes over directions and frequencies, term by term |
| `directions.py` | axes of a direction |
| `sides.py` | which side of an open surface the radar sees |
| `rcs.py` | `warpsar.rcs`: checks, the sweep, and what a user should know before trusting it |
| `contributors.py` | what each face and each edge sends back in one direction |
| `held.py` | amplitudes of one direction with all that is discrete held, as programs that run backward |
| `borders.py` | borders of light, and what a moving border adds to a derivative |
| `left_out.py` | what a scene declares and a product with phase does not have |
| `learned.py` | what has a derivative, by name |
| `gradients.py` | `warpsar.rcs_gradients` |
| `command.py` | the command `rcs`, of a scene file or a mesh file: table, plots, JSON |
| `report.py` | report.html of the command |
| `interval.py` | an interval for what the model leaves out |
| `isar.py` | range profiles of a sweep, and the image of the body that they make |
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
