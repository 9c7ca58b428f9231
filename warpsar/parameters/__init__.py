"""What of a scene can change: every number that can be learned, moved or diagnosed, under one dotted name.

parameter.py  one of them: value, unit, bounds, coordinate, what is known of it, and where it has a derivative
tree.py       all of a scene, by name (`Scene.parameters`); older names are understood
at.py         the scene with other values
"""
