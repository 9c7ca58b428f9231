"""From residual to missing effect: the procedure of `warpsar diagnose`, one question a file.

evidence.py   what is left of the measured images, and how it is correlated
templates.py  what each effect would leave, from rays of its own
score.py      how well a template fits what is left, beyond what the surface can absorb
bootstrap.py  how large the largest score gets by speckle alone
scan.py       whether something is left that no effect explains, and where
refit.py      full fits with an effect added, and what views that were left out say of it
procedure.py  the steps, in their order
"""
