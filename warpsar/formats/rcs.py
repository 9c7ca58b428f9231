"""Curves of radar cross-section: `warpsar.io.curves` reads them, and they become `[[curves]]`."""

from __future__ import annotations

from warpsar.formats.base.format import Format

FORMAT = Format(
    "rcs",
    "curves of radar cross-section",
    "`.csv`, `.txt`",
    "see [below](#curves-of-radar-cross-section); no view is needed",
    read=None,
    suffixes=(".csv", ".txt"),
)
