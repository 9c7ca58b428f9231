"""One turn of the search: which effect, or which body, is likeliest.

scoring.py           what each effect scores in one turn
field_projection.py  score tests beside learned fields
signature.py         whether an effect's name is earned
shortlist.py         which candidates get a full fit
screening.py         short fits of one candidate, given up where they fall far behind
addition.py          which refitted candidate is added on trial
pruning.py           what is needless beside the rest of a model, and other settings
rivals.py            which other effect would have done as well
geometry_search.py   which changes of geometry are worth a comparison with effects
sensor_search.py     which angles and spacings may be wrong
geometry_trial.py    the likeliest change of geometry beside the likeliest effect
"""
