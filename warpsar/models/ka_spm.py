"""Small perturbation and geometric optics, mixed: the default."""

from warpsar.models.base.model import BackscatterModel, Domain
from warpsar.models.base.parameters import OF_SURFACES

MODEL = BackscatterModel(
    name="ka_spm",
    summary="small perturbation and geometric optics, mixed",
    order=0,
    parameters=OF_SURFACES,
    domain=Domain("small perturbation and of geometric optics"),  # each has its own: render/domains.py
    coherent_only=True,
)
