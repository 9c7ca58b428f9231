"""What is left at the end, in plain sentences and as diagnosis.json has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from warpsar.diagnosis.left.summary import Left, PowerRatio

CLEAR = 3.5  # standard errors from which a share of the pixels is named
_MOVES = {
    "surface": "Other views show it at the same place of the surface, so it moves with the surface: look at the mesh "
    "and its materials there",
    "image": "Other views show it at the same place of the image, whatever lies there: look at the radar and the "
    "processing",
    "both": "Other views show it at the same place of the surface and of the image: they look too much alike to tell "
    "which",
    "neither": "No other view shows it clearly, neither at the same place of the surface nor of the image: look at "
    "this image first",
    "one view": "There is one view alone, so nothing says whether it moves with the surface or with the image",
}


def described(left: Left) -> dict[str, Any]:
    """`left_at_the_end.description` of diagnosis.json."""
    spectrum = left.spectrum
    return {
        "sentences": sentences(left),
        "where": left.where,
        "image": left.image,
        "ratio_db": left.ratio_db,
        "error_db": left.error_db,
        "shape": asdict(left.shape),
        "spectrum": {
            "periodic": left.shape.kind == "periodic",
            "per_m_range": spectrum.peak_range,
            "per_m_azimuth": spectrum.peak_azimuth,
            "period_m": spectrum.period_m,
            "minus_log_p": spectrum.minus_log_p,
        },
        "moves_with": asdict(left.moves),
        **{
            key: [asdict(one) for one in shares]
            for key, shares in (
                ("by_view", left.views),
                ("by_surface", left.surfaces),
                ("by_incidence", left.incidences),
                ("by_polarization", left.polarizations),
            )
        },
        "in_the_dark": [asdict(one) for one in left.dark],
        "clipped": left.clipped,
        "nearest": [asdict(one) for one in left.nearest],
    }


def first_sentence(left: Left) -> str:
    """Where it is, how much and of what shape."""
    shape = left.shape
    size = f"{shape.range_m:.3g} m in range by {shape.azimuth_m:.3g} m in azimuth"
    about = f"{left.image}, {shape.kind} about row {shape.row}, column {shape.col} ({size})"
    if left.where == "dark":
        about = f"dark pixels of {about}"
    return f"What is left is strongest in {about}: {_much(left)}."


def _much(left: Left) -> str:
    if not np.isfinite(left.ratio_db):
        return "power is measured where the model has none" if left.shape.z > 0 else "nothing is measured there"
    way = "brighter" if left.ratio_db > 0 else "darker"
    return f"the image is {abs(left.ratio_db):.2f} +- {left.error_db:.2f} dB {way} than the model"


def sentences(left: Left) -> list[str]:
    """All of it; one sentence where nothing has to be explained."""
    if not left.unexplained:
        return [
            "What is left needs no explanation: speckle alone leaves as much.",
            *_clipped(left),
        ]
    sentences = [first_sentence(left)]
    moves = left.moves
    numbers = f" (z {moves.z_surface:.1f} along the surface, {moves.z_image:.1f} in the image)"
    sentences.append(_MOVES[moves.way] + ("" if moves.way == "one view" else numbers) + ".")
    if left.shape.kind == "periodic":
        s = left.spectrum
        sentences.append(
            f"It repeats every {s.period_m:.3g} m ({s.peak_range:.3g} per metre in range, {s.peak_azimuth:+.3g} in "
            f"azimuth; -ln p {s.minus_log_p:.1f})."
        )
    for what, shares in (
        ("By image", left.views),
        ("By surface", left.surfaces),
        ("By incidence", left.incidences),
        ("By polarization", left.polarizations),
    ):
        sentences += _shares(what, shares)
    impossible = [one for one in left.dark if one.impossible]
    if impossible:
        some = ", ".join(f"{one.impossible} of {one.pixels} in {one.image}" for one in impossible)
        sentences.append(f"Dark pixels measure power that the model cannot have: {some}.")
    return sentences + _clipped(left)


def _shares(what: str, shares: Sequence[PowerRatio]) -> list[str]:
    """The shares that differ clearly, the clearest first; none where there is one share alone."""
    clear = sorted((one for one in shares if abs(one.z) > CLEAR), key=lambda one: -abs(one.z))
    if not clear or len(shares) < 2:
        return []
    some = ", ".join(f"{one.name} {one.ratio_db:+.2f} +- {one.error_db:.2f} dB" for one in clear)
    return [f"{what}, measured over modelled power as a whole: {some}."]


def _clipped(left: Left) -> list[str]:
    return [
        f"{name} has a top level: {count} pixels measure its largest value. The image is clipped."
        for name, count in left.clipped.items()
    ]
