"""The images of all processes on the first one."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpsar.evaluation.image import EvaluatedImage
from warpsar.learning.observation import Observation
from warpsar.runtime.distributed import Ranks
from warpsar.scene.scene import Scene

_OF_IMAGE = ("simulated", "valid", "incidence_deg", "material", "range_m", "azimuth_m")
_OF_OBSERVATION = ("measured", "interior", "silent", "dark")


def collected(scene: Scene, images: list[EvaluatedImage], ranks: Ranks) -> list[EvaluatedImage]:
    """The images of all ranks on the first one, in the order of the scene's views."""
    arrays: dict[str, np.ndarray] = {}
    said = []
    for number, image in enumerate(images):
        arrays |= {f"{number} {name}": getattr(image, name) for name in _OF_IMAGE}
        arrays |= {f"{number} {name}": getattr(image.observation, name) for name in _OF_OBSERVATION}
        seen = image.observation
        said.append(
            {
                "observation": [image.view.name, seen.polarization, seen.looks, seen.looks_estimated],
                "image": {"gain": image.gain, "floor": image.floor, "sampling_noise": image.sampling_noise},
                "metrics": image.metrics,
            }
        )
    order = [view.name for view in scene.views]
    found = []
    for about, stored in zip(ranks.gather(said), ranks.collect(arrays), strict=False):
        for number, one in enumerate(about):
            view, polarization, looks, estimated = one["observation"]
            of: dict[str, Any] = {name: stored[f"{number} {name}"] for name in (*_OF_IMAGE, *_OF_OBSERVATION)}
            observation = Observation(
                view=scene.views[order.index(view)],
                polarization=polarization,
                looks=looks,
                looks_estimated=estimated,
                **{name: of[name] for name in _OF_OBSERVATION},
            )
            found.append(
                EvaluatedImage(
                    observation=observation,
                    metrics=one["metrics"],
                    **one["image"],
                    **{name: of[name] for name in _OF_IMAGE},
                )
            )
    return sorted(found, key=lambda image: order.index(image.view.name))
