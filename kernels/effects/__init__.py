"""Kernels of the effects: one file each, beside `warpsar.effects`."""
