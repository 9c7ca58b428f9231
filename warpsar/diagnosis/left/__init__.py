"""What is left at the end: where, how much, of what shape.

summary.py  what is left at the end
figures.py  what is left, in three pictures
shape.py    its shape and spectrum
words.py    what is left, in sentences and in diagnosis.json
nearest.py  the explanations that come nearest, and what speaks against each
place.py    where on the surface something is left
"""
