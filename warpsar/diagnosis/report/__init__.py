"""report.html of `warpsar diagnose`.

page.py     the page
law.py      the learned law of backscatter, drawn
left.py     what is left
objects.py  objects before and after
summary.py  the answer
surface.py  parameters before and after
turns.py    a turn
"""
