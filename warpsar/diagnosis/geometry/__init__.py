"""Ways in which a scene's geometry may be wrong: bodies elsewhere, of another size, absent or missing; wrong angles and
pixel spacings.

Each of them is one file here. `base/` says what is asked of it, and `registry.py` finds it by name: a new one is a new
file, its test, and a row of docs/diagnosis.md.
"""
