"""What speckle does to an intensity image.

likelihood: losses, their constants, and metrics. looks: the equivalent number of looks of an image.
"""
