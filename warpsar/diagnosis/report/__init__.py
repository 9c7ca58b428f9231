"""report.html of `warpsar diagnose`.

page.py       the page
first.py      its first screen: the verdict, a picture before and after
law.py        the learned law of backscatter, drawn
left.py       what is left
next_step.py  what to do next
summary.py    the answer
surface.py    parameters before and after
turns.py      a turn
"""
