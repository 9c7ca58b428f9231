"""What the models of a diagnosis share: how one is fitted, and how two are compared.

fit_setup.py     rays and pixels that all fits share
frozen.py        which pixels are compared
judge.py         models beside all measured images, test views among them
refit.py         full fits of a model
change.py        how bodies of a scene differ from the declared ones
names.py         what a finding is called
movable.py       which bodies may be moved, and what a fit frees of them
all_pixels.py    models compared on lit and unlit pixels
explained.py     how much of what is unlike speckle a change explains
effect_gain.py   how far the likeliest effect is ahead of any body
left_out.py      what views left out say of an effect
field_prior.py   how rough learned fields are
projection.py    where a place of the world lies in an image
carried.py       whether the surface could be the cause
"""
