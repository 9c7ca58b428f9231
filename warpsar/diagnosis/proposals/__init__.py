"""What `geometry/missing_object.py` tries: an object that several views agree on.

bodies.py    which body stands in a place
fit.py       an object on trial
left_out.py  whether it explains what is seen, also in views left out
places.py    places on which several views agree
shapes.py    the bodies that are tried
"""
