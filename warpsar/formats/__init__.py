"""The formats of radar measurements: docs/import.md.

Each file here is one format, under its name on the command line. `base/` says what a format is, and holds what several
share. `registry` finds formats by name and by a file's content.
"""
