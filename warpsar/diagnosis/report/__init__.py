"""report.html of `warpsar diagnose`.

page.py       the page
first.py      its first screen: the verdict, a picture before and after
left.py       what is left
next_step.py  what to do next
summary.py    the answer
turns.py      a turn
"""
