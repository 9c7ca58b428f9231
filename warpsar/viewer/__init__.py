"""A scene in 3D in a browser: `warpsar view`.

command.py  the command
surface.py  triangles to draw, with materials, objects and parameters at their corners
drapes.py   images of the views, and how they lie on the surface
contributors.py  a body whose faces and edges show what they send back: `warpsar rcs --contributors`
points.py   strong scatterers as points
page.py     the page and its colours, which holds everything and fetches nothing
assets/     the page's own script and style, and three.js
"""
