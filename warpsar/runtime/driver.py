"""Warp's start, without its line about the CUDA driver on machines that have none."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

_WARNING = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver"


@contextmanager
def no_driver_warning() -> Iterator[None]:
    """Around `wp.init`. Warp's native library writes the line to stderr itself, and no setting of Warp leaves it out
    (native/cuda_util.cpp of 1.19): what it writes is held back here, and all but that line is then passed on."""
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (AttributeError, OSError):  # no stderr
        yield
        return
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
            held.seek(0)
            for line in held:
                if not line.startswith(_WARNING):
                    os.write(2, line)
