"""How many threads BLAS starts."""

from __future__ import annotations

import os


def in_one_thread() -> None:
    """Let BLAS work in the thread that calls it. Libraries read this when NumPy is imported, so call it before.

    A fit makes many small products, from threads of its own. With two threads of BLAS beside them, a quarter of the
    time went into their waiting for one another. Who sets the variables is obeyed.
    """
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        os.environ.setdefault(name, "1")
