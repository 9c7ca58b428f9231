"""What dark pixels say: power where the model puts none.

evidence.py    what dark pixels say
pixels.py    what a model puts into dark pixels, and what is measured there
scan.py      whether something is left in dark pixels
"""
