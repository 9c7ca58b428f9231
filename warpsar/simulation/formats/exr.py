"""OpenEXR: float32 channels under their names, facts in the header."""

from __future__ import annotations

from functools import partial

from warpsar.io.images import write_exr
from warpsar.simulation.ground import MapGround
from warpsar.simulation.image_format import ImageFormat, Parts
from warpsar.simulation.view import SimulatedView


def parts(view: SimulatedView, name: str, ground: MapGround | None) -> Parts:
    yield "", f"{name}.exr", partial(write_exr, channels=view.beta0, header=view.metadata)
    if extra := view.channels():
        yield "layers", f"{name}_layers.exr", partial(write_exr, channels=extra, header=view.metadata)


FORMAT = ImageFormat("exr", "EXR", "`<view>.exr`, `<view>_layers.exr`", "image viewers, OpenEXR, OpenImageIO", parts)
