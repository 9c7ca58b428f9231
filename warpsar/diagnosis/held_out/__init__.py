"""What the model of measured views lacks, by how well it predicts views that were left out: `diagnose --folds`.

command.py     the command, and diagnosis.json
report.py      report.html
search.py      hypotheses tried one after the other: what stays
hypotheses.py  what is tried
box.py         a body as a box: what a rival knows that has no mesh
geometry.py    sizes and angles that the scene frees with a tolerance
glints.py      glints of bodies, found one by one
model.py       how a model of some views is fitted, and how well it predicts others
arcs.py        which views are left out together
azimuths.py    how a table's azimuths are counted
"""
