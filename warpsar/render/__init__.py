"""From hits and surface to images, with gradients to every parameter.

rendered: what every render offers.
render: with a view's hits in memory.
models: sigma0 by the backscatter model of each hit, and learned terms.
asked: what a launch of sigma0 is recorded for.
ways: launches of the models that need more than their functions, a file for each.
bands: with hits that are traced again, band by band.
domains: how much of the lit surface lies outside its model's domain.
tangents: how images change with the nodes of a surface, in forward mode.
"""
