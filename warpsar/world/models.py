"""What a material's backscatter model needs, and what it does not take (docs/scattering.md)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

LEARNS: dict[str, tuple[str, ...]] = {
    "ka_spm": ("eps_r", "rms_height_m", "correlation_length_m", "specular_fraction"),
    "i2em": ("eps_r", "rms_height_m", "correlation_length_m"),
    "oh": ("eps_r", "rms_height_m"),
    "dubois": ("eps_r", "rms_height_m"),
    "facet": ("level",),
}
"""The values that a model's sigma0 depends on, and so those that can be learned."""


TERM = "learned_term"
"""What `learn` calls the learned term of a material: it is trained while the material's values are held."""
TABLE = "sigma0"
"""What `learn` calls the values of a material's table."""

OF_THE_DEFAULT = ("two_scale",)
OF_A_SURFACE = ("two_scale", "eps_gradient", "multibounce", "edge_diffraction")
"""Effects that work on the default model's equations, and on a surface's permittivity, which a table has not."""


def effects_without(model: str) -> tuple[str, ...]:
    """Effects that a material with this model does not take."""
    return () if model == "ka_spm" else OF_A_SURFACE if model == "facet" else OF_THE_DEFAULT


def needless(model: str, key: str) -> bool:
    """Whether a material with this model may leave the value out."""
    return model != "ka_spm" and key not in LEARNS[model]


def refusals(material: Any, stated: set[str]) -> list[str]:
    """What does not fit the model, in words; `stated` are the keys that the scene file has."""
    model = material.model
    found = []
    if (material.sigma0 is not None) != (model == "facet"):
        found.append(
            'model = "facet" needs sigma0, the name of a CSV'
            if model == "facet"
            else f'found sigma0 and model = "{model}"; allowed with model = "facet" alone'
        )
    if material.learned_term is not None and model == "facet":
        found.append('found learned_term and model = "facet"; a table needs none')
    if "learn" in stated:
        found += _not_learned(model, material.learn)
    if model == "ka_spm":
        return found
    if material.specular_fraction != 0.0:
        found.append(f'found specular_fraction and model = "{model}"; allowed with model = "ka_spm" alone')
    if model == "i2em" and material.spectrum == "separable":
        found.append('found spectrum = "separable" and model = "i2em"; allowed are "gaussian" and "exponential"')
    if material.conductor or material.thickness_m is not None:
        found.append(f'found conductor or thickness_m and model = "{model}"; allowed with model = "ka_spm" alone')
    if model == "facet" and material.layout != "uniform":
        found.append(f'found layout = "{material.layout}" and model = "facet"; allowed is "uniform"')
    return found


def _not_learned(model: str, learn: Sequence[str]) -> Iterator[str]:
    """What `learn` must not name with the model, in words."""
    if TERM in learn and (len(learn) > 1 or model == "facet"):
        yield f"learn: found {', '.join(learn)} with a material of {model}; {TERM} is learned alone"
    if TABLE in learn and model != "facet":
        yield f'learn: found {TABLE} and model = "{model}"; allowed with model = "facet" alone'
    elif TABLE in learn and len(learn) > 1:
        yield f"learn: found {', '.join(learn)}; {TABLE} is learned alone"
    allowed = LEARNS[model] if model != "facet" else (*LEARNS[model], TABLE)
    for key in learn:
        if key not in (*allowed, TERM, TABLE):
            yield (
                f"learn: found {key}; sigma0 of the model {model} does not depend on it; allowed: {', '.join(allowed)}"
            )
