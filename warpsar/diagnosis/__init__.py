"""Which effect the images hold and the scene does not declare: `warpsar diagnose`, from residual to verdict.

The files, the outermost first:

command.py          the command
curve_command.py    the command on curves of RCS
curve_folds.py      frequencies of curves that are held back in turn
curves.py           which terms and materials measured curves of RCS show
curve_layers.py     a layer on the metal of a part: the likeliest one, and what curves tell of it
curve_materials.py  the materials that parts of a body may have, and the curves beside such bodies
result.py           `diagnose`, and its result on all views
single_views.py     the angle of a test view, which no train view can tell
surface_moves.py    how far the surface's parameters went, and their intervals
content.py          what diagnosis.json holds
written_scene.py    what the written scene and diagnosis.json say of found objects
known.py            what became of values known to a tolerance
field_content.py    what is said of learned fields
alternatives.py     which measurement would decide between two explanations
role_metrics.py     metrics of all images of a role, dark pixels among them
found.py            options, candidates, turns and the verdict
run_log.py          what a run has found so far, entry after entry, and its checkpoint

The rooms, each importing from those below it:

held_out/           the same by views left out in arcs of azimuth: `diagnose --folds`
report/             report.html of `warpsar diagnose`
left/               what is left at the end: where, how much, of what shape
search/             the search for what is missing: turns, confirmations, and how far it has come
turn/               one turn of the search: which effect, or which body, is likeliest
phase/              what the phase of complex images says: an error over slow time
dark/               what dark pixels say: power where the model puts none
geometry/           ways in which the geometry may be wrong, a file each
proposals/          what the mesh lacks: an object that several views agree on
scores/             how well what is left fits the template of an effect
models/             what the models of a diagnosis share: how one is fitted, and how two are compared
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
