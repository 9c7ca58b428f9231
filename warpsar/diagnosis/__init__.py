"""From residual to missing effect: the procedure of `warpsar diagnose`, one question a file.

evidence.py   what is left of the measured images, and how it is correlated
templates.py  what each effect would leave, from rays of its own
score.py      how well a template fits what is left, beyond what the surface can absorb
bootstrap.py  how large the largest score gets by speckle alone
scan.py       whether something is left that no effect explains, and where
refit.py      full fits of a model, and the pixels and rays that all models share
survey.py     where a fit begins that no derivative leads to
screening.py  which candidates are worth a full fit
left_out.py   what views that an effect's parameters have not seen say of it
carried.py    whether the surface could be what an effect of the image was taken for
procedure.py  the steps, in their order
judge.py      how far models are from all images, test views among them
place.py      where on the surface something is left
command.py, report.py  what is written, and the page that a reviewer reads
"""
