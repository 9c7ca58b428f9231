"""The formats of simulated images: docs/simulate.md.

Each file here is one format, under its name on the command line. `registry` finds them by name.
"""
