"""Measured radar data, read from its own formats and brought onto the slant-plane grid of a view.

importer: `warpsar import`. formats: which reader a file needs. cphd, gotcha (with mat5), mstar, nisar, sicd, pictures:
the readers. data: what they give. earth: where the world lies on the earth. gridding: a measurement onto a view's grid.
focus: phase history to image. ground: where pixels lie. resample: power between pixels. curves: radar
cross-sections.
chips, view_table: many chips and a table of their angles, in one call. jpeg: 8-bit pictures of amplitude. declared:
widths of the response that a header declares. response: the same as `[effects.point_spread]`. placed: where a scene
lies on a map.
"""
