"""What corner reflectors say of an image: measured beside predicted, and what the difference means.

attitude.py     how a trihedral stands, and its cross-section in closed form
engine.py       its cross-section by the engine, from the same mesh
sites.py        the table of sites
presence.py     when a reflector stands, and where one is whose place is not known
point.py        a point target in an image: place, cross-section with an interval, response
measure.py      a reflector in a product
differences.py  measured less predicted, of all reflectors and dates
causes.py       what may have caused it
scatter.py      the errors of values
chance.py       how often values without a cause look as if they had one
joint.py        causes fitted together: what earlier dates need and later ones confirm
turns.py        all attitudes that fit
forecast.py     later dates foretold from earlier ones
unpredicted.py  reflectors without a prediction, compared with themselves
explain.py      the causes alone and together, and what is tied
geolocation.py  how far reflectors lie off orbit and survey, and what may move them
table.py        reflectors.csv
figures.py      drawings of the report
report.py       report.html
command.py      the command, and `warpsar.reflectors`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
