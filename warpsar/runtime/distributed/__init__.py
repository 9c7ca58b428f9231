"""The processes of one run that torchrun starts. `once` is what the rest of the program sees of them.

processes.py  sums, values and tasks that they share. torchrun.py  what torchrun says of them. travel.py  how values get
from one to another.
"""
