"""GeoTIFF, TIFF, EXR and NPY: pictures whose quantity only their maker knows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.errors import InputError
from warpsar.measured.data import Facts, ImageChip, Quantity, reading
from warpsar.measured.earth import EarthFrame, geodetic_to_ecef
