"""What a format is, and what several formats share.

format: what a format declares. data: what a reader gives. acquisition: what a writer takes. located: a product's image,
placed by its orbit. pictures: images already in the slant plane. declared: widths of the response that a header
declares. mat5: is a MATLAB file sound?
"""
