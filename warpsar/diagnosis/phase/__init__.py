"""What the phase of complex images says: an error over slow time, found by the contrast of the image.

`spectrum.py`: the azimuth spectrum of an image, and its contrast under a phase. `fit.py`: the phase of the most
contrast. `search.py`: what families find on two folds of rows, beside speckle. `least.py`: from which size on an error
would be found. `ask.py`: whether a phase error is there, on rows that decided nothing. `declared.py`: the questions of
a scene, and the scene that declares what was found.
"""
