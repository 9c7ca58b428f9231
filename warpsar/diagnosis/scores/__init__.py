"""How well what is left fits the template of an effect.

evidence.py      what is left of the measured images, and how it is correlated
templates.py     what each effect would leave, from rays of its own
partly_known.py  what a tolerance leaves of a parameter's freedom to imitate an effect
score.py         how well a template fits the residual, beyond what the surface can absorb
bootstrap.py     how large the largest score gets by speckle alone
"""
