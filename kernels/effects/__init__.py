"""Kernels of the effects: the file `<name>.py` belongs to `warpsar/effects/<name>.py`."""
