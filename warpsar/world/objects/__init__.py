"""Objects that a scene places: `[[objects]]`.

table: the table of a scene file. poses: the bodies of a CSV file with a pose in each line.
shapes: primitives without a file. pose: the way from an object's frame to the world.
assembly: base mesh and objects as one mesh. groups: named parts of the scene's own mesh.
"""
