"""What a change of geometry is.

change.py   what everybody asks of one
body.py     of a body of the scene
sensor.py   of how the radar looks: angles of views, sizes of pixels
"""
