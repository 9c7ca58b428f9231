"""The search for what is missing: turns, confirmations, and how far it has come.

loop.py                   the loop: score, add on trial, confirm, repeat
geometry_confirmation.py  whether a change of geometry holds beside everything else
confirmation.py           which added effects hold, each asked beside all the others
record.py                 how far a run has come, and its checkpoint
outcome.py                what became of every effect in a turn, in words
procedure.py              rays, pixels, the declared model, and then the search
"""
