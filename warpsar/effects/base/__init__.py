"""What an effect is made of.

`effect.py`: the class that each effect derives from. `parameter.py`: its parameters and settings. `fitted.py`: which
of them a fit moves. `recorder.py`: the render that it records on. `trial.py`: how a score test looks for it.
`signature.py`: what it leaves that nothing else does. `polarization.py`: polarizations by their codes.
`phase.py`: what it does to products with phase. `slow_time.py`: a phase over the aperture. `product.py`: their names.
`sidelobes.py`: a floor beside power that falls with distance from what is bright.
`blur.py`: convolution along one axis, with a width that a fit can move.
"""
