"""What the models of a diagnosis share: how one is fitted, and how two are compared.

fit_setup.py     rays and pixels that all fits share
frozen.py        which pixels are compared
judge.py         models beside all measured images, test views among them
refit.py         full fits of a model
change.py        a change of geometry that may explain what is left
names.py         what a finding is called
sensor.py        wrong angles and pixel spacings
movable.py       which bodies may stand elsewhere or be absent
all_pixels.py    models compared on lit and unlit pixels
effect_gain.py   how far the likeliest effect is ahead of any body
left_out.py      what views left out say of an effect
field_prior.py   how rough learned fields are
projection.py    where a place of the world lies in an image
carried.py       whether the surface could be the cause
"""
