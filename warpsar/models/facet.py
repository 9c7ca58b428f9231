"""A table of sigma0 over incidence."""

from warpsar.models.base.model import BackscatterModel, Domain, SurfaceParameter

MODEL = BackscatterModel(
    name="facet",
    summary="a table of your own over incidence",
    order=40,
    parameters=(
        SurfaceParameter(
            *("level", "g", "log", 1e-4, 1e4),
            limits=(0.0, 1e6),
            description="Factor on the table's sigma0, linear; may be learned.",
            example=1.3,
        ),
    ),
    domain=Domain("its table"),
    from_table=True,
)
