"""Which surface and effect parameters explain measured images, and how well the images determine them.

options: how to fit. coordinates: what x is. misfit: the loss.
held: which views a process holds. view: one of them, and how its image changes with x.
prior: what the scene knows to a tolerance. pull: where the images pull against it.
roughness: what rough fields cost: total variation, and what diagnosis expects. sparse_quadratic: their steps.
problem: views and images as one function of x. optimise, adam: one step of a fit.
gradcheck: the gradient against differences. descent: a fit from first to last iteration. learn: the whole fit.
identify: intervals of a few parameters. fields: intervals of maps.
geometry: bodies, angles and spacings as numbers. pose_pixels: the pixels that tell them. pose: surface,
effects and geometry as one problem, and its descent. field_levels: fields that move as a whole meanwhile.
pose_sharing: objects that share a render. pose_search: from metres away to the likeliest pose. glints: bright points
beside a body's shape. learned_objects: poses in `learn`.
object_figures: objects before and after. term: the learned term of a material's sigma0, from images.
table: its table of sigma0, from images, with a figure. device_values: what both are fitted
by. metrics: how well the images of a fit agree. trust: do the intervals hold, and what did a fit make worse?
curve_likelihood: what measured curves of RCS say of numbers. curves: materials from them.
results: what was learned, as a scene. command: `warpsar learn`.
profiles: intervals of a few parameters by profile likelihood.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
