"""Which effect the images hold and the scene does not declare: `warpsar diagnose`, from residual to verdict.

command.py         the command
result.py          `diagnose`, and its result on all views
procedure.py       rays, pixels, the declared model, and then the search
search.py          the loop: score, add on trial, confirm, repeat
geometry.py        an object elsewhere, absent or missing: what a scene holds of it
movable.py         which bodies may stand elsewhere or be absent
geometry_search.py which of them are worth a comparison with effects
lead.py            how far the likeliest effect is ahead of any of them
geometry_trial.py  the likeliest of them beside the likeliest effect
geometry_confirmation.py  whether one holds beside everything else
all_pixels.py      models compared on lit and unlit pixels
other_meshes.py    rays through changed meshes
course.py          how far a run has come, and its checkpoint
found.py           options, candidates, turns and the verdict
bench.py           rays and pixels that all fits share
frozen.py          which pixels are compared
evidence.py        what is left of the measured images, and how it is correlated
templates.py       what each effect would leave, from rays of its own
score.py           how well a template fits the residual, beyond what the surface can absorb
bootstrap.py       how large the largest score gets by speckle alone
partly_known.py    what a tolerance leaves of a parameter's freedom to imitate an effect
field_prior.py     how rough learned fields are
field_projection.py  score tests beside learned fields
field_content.py   what is said of learned fields
scoring.py         what each effect scores in one turn
dark.py            what dark pixels say
dark_pixels.py     what a model puts into dark pixels, and what is measured there
dark_scan.py       whether something is left in dark pixels
signature.py       whether an effect's name is earned
shortlist.py       which candidates get a full fit
screening.py       short fits of one candidate, given up where they fall far behind
survey.py          where a fit begins that no derivative leads to
refit.py           full fits of a model
addition.py        which refitted candidate is added on trial
confirmation.py    which added effects hold, each asked beside all the others
rivals.py          which other effect would have done as well
last_resort.py     a law of backscatter, where nothing named explains what is left
left_out.py        what views left out say of an effect
carried.py         whether the surface could be the cause
pruning.py         what is needless beside the rest of a model
settings.py        which settings the added effects have beside all the others
outcome.py         what became of every effect in a turn, in words
alternatives.py    which measurement would decide between two explanations
judge.py           how far models are from all images, test views among them
place.py           where on the surface something is left
left.py            what is left at the end
left_shape.py      its shape and its spectrum
left_moves.py      whether it moves with the surface or with the image
left_words.py      what is left, in sentences and in diagnosis.json
left_figures.py    what is left, in three pictures
geometry.py        a change of geometry that may explain what is left
proposals.py       an object that the mesh lacks
proposals_place.py     places on which several views agree
proposals_ground.py    where the ground is free
proposals_bodies.py    which body stands in a place
proposals_shapes.py    the bodies that are tried
proposals_fit.py       an object on trial
proposals_left_out.py  whether it explains what is seen, also in views left out
nearest.py         the explanations that come nearest, and what speaks against each
projection.py      where a place of the world lies in an image
known.py           what became of values known to a tolerance
content.py         what diagnosis.json holds
report.py          the report's page
report_summary.py  its answer
report_turns.py    its turns
report_objects.py  its objects before and after
report_surface.py  its parameters
report_law.py      that law, drawn
report_left.py     what is left
"""
