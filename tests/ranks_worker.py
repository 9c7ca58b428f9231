"""What each process does in tests/runtime/test_distributed.py; the first one writes what all of them found."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpsar.errors import InputError
from warpsar.evaluation.command import run as evaluate
from warpsar.io.images import write_tiff
from warpsar.learning.command import LearnOptions, run
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.runtime.distributed.processes import Sharing, join
from warpsar.scene.scene import Scene
from warpsar.simulation.command import run as simulate


def collectives(ranks: Sharing, device: Any) -> dict[str, Any]:
    rank, size = ranks.rank, ranks.size
    # 1e16 + 1 = 1e16: what comes out depends on the order, which has to be the same for all
    awkward = np.random.default_rng(rank).normal(size=4097) * 10.0 ** np.random.default_rng(9).integers(-8, 8, 4097)
    on_device: Any = wp.array(awkward.astype(np.float32), dtype=float, device=device)
    ranks.sum_on_device(on_device)
    matrix: Any = wp.array(np.full((3, 2), rank + 1.0, np.float32), dtype=float, device=device)
    ranks.sum_on_device(matrix)

    def refused() -> None:
        if rank == size - 1:
            raise InputError("the last one does not want to")

    try:
        ranks.agree(refused)
        refusal = "none"
    except InputError as error:
        refusal = f"{error} {error.quiet}"
    collected = ranks.collect({"a": np.arange(rank + 1), "b": np.full((2, 2), rank, np.float32)})
    once, again = ranks.counter(), ranks.counter()
    numbers = [once(1) for _ in range(5)]
    ranks.barrier()
    again(7)
    handed = ranks.hand_out({"x": np.array([0.1, rank])} if rank == 0 else None)
    assert handed is not None
    return {
        "rank": rank,
        "sum": ranks.sum(awkward).tobytes().hex(),
        "sum_on_device": on_device.numpy().tobytes().hex(),
        "matrix": matrix.numpy().tolist(),
        "largest": ranks.largest(float(rank)),
        "same": ranks.same([float(rank), 0.1]).tolist(),
        "gathered": ranks.gather({"rank": rank, "text": "ä" * (10 * rank), "number": 0.1 + rank}),
        "collected": [[each["a"].tolist(), each["b"].dtype.str, each["b"].tolist()] for each in collected],
        "handed": handed["x"].tolist(),
        "nothing": ranks.hand_out(None),
        "numbers": numbers,
        "refusal": refusal,
    }


def fit(device: Any, path: Path, max_memory_gib: float | None) -> dict[str, Any]:
    scene = Scene.load(path)
    problem = FitProblem(scene, device, shared=True, max_memory_gib=max_memory_gib)
    x = problem.x0 + 0.05
    loss, gradient = problem.gradient(x)
    return {
        "views": [view.view.name for view in problem.views],
        "loss": loss,
        "gradient": gradient.tolist(),
        "value": problem.value(problem.modelled(x)),
        "keeps_hits": problem.keeps_hits,
    }


def refusal(ranks: Sharing, device: Any, path: Path) -> str:
    """What a fit says to whose second view no pixel is left, which one rank alone finds out."""
    scene = Scene.load(path)
    black = path.parent / f"black_{ranks.size}.tif"
    if ranks.first:
        write_tiff(black, np.zeros(scene.grid.shape))
    ranks.barrier()
    views = [
        v.model_copy(update={"images": dict.fromkeys(v.images, black)}) if v.name == "v1" else v for v in scene.views
    ]
    try:
        FitProblem(replace(scene, views=views), device, shared=True)
    except InputError as error:
        return f"{error.quiet} {error}"
    return "none"


def main() -> None:
    work = Path(sys.argv[1])
    device = devices.resolve_device("cpu")
    ranks = join(device)
    found: dict[str, Any] = {"collectives": collectives(ranks, device)}
    found["refusal"] = refusal(ranks, device, work / "effects" / "scene.toml")
    for name in sys.argv[2:]:
        found[name] = {
            kind: fit(device, work / name / "scene.toml", gib)
            for kind, gib in (("kept", None), ("banded", 1e-7))
            if kind == "kept" or name != "texture"
        }
        weights = {"rms_height_m": 1.0} if name == "texture" else {}
        options = LearnOptions(starts=2, iterations=30, total_variation=weights)
        run(work / name / "scene.toml", work / f"{name}_{ranks.size}", device="cpu", options=options)
    evaluate(work / "effects" / "scene.toml", work / f"evaluate_{ranks.size}", device="cpu")
    simulate(work / "effects" / "scene.toml", work / f"simulate_{ranks.size}", device="cpu")
    everything = ranks.gather(found)
    if ranks.first:
        (work / f"found_{ranks.size}.json").write_text(json.dumps(everything))


if __name__ == "__main__":
    main()
