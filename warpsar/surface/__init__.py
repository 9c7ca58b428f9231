"""The surface parameters of all materials as one vector of nodes, on the host and on a device.

surface: nodes and what they mean. stage: what all views share on a device. samples: hits merged for shading. spread:
gradients of hits brought back to nodes. tables: sigma0 over incidence. terms: learned terms of sigma0.
bistatic: numbers that the kernels of bistatic scattering share.
"""
