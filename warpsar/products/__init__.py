"""What a radar product of the earth says of its geometry and its power.

orbit.py          state vectors, and places between them
zero_doppler.py   from a place on the earth to azimuth time and slant range, and back; the direction to the radar
ground_range.py   polynomials between slant range and ground range, over azimuth time
grid.py           azimuth time and slant range of lines and pixels, bursts included
lookup.py         tables over lines and pixels: calibration and noise
tops.py           the drift of the spectrum in TOPS bursts
product.py        all of one product
"""
