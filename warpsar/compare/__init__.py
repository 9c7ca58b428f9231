"""How well does a model explain what was measured? `learn`, `evaluate` and `diagnose` ask here, and nowhere else.

observation.py  which measured pixels are compared, and how their speckle is distributed
modelled.py     a view as the model has it, by exact areas where they can be had
metrics.py      how far one image is from the model, and several together
contract.py     what images and curves have in common, beside a model
comparison.py   one measured image beside its model; all images of a scene
edges.py        whether edges and borders of shadows lie where the model has them
profiles.py     whether the power of rows, or of columns, is off the model
judgement.py    is anything left beside speckle?
aim.py          where a view was aimed: the shift at which an image and its prediction agree best
rivals.py       predictions that need no physics: other measured images
laid.py         the mean of train images on the ground, beside test images
prediction.py   how well views are predicted that no fit has seen, beside the rivals
curve.py        one measured curve of RCS beside its model; what is left of curves
evaluation.py   all images and curves of a scene, what they give together, and the judgement on each role's
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
