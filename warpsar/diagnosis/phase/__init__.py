"""What the phase of complex images says: an error over slow time, found by the sharpness of the image.

`lines.py`: the azimuth spectrum of an image, and its sharpness under a phase. `fit.py`: the phase that makes it sharpest.
`ask.py`: whether a phase error is there, on rows that decided nothing. `declared.py`: the questions of a scene, and the
scene that declares what was found.
"""
