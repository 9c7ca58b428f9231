"""Facets of the ground in the pixels of a product: areas cut by pixels, with a ray to the radar from each piece.

A facet is a triangle on the ground. Its corners have a line (zero-Doppler time) and a slant range, so it is a triangle
in the image as well. Within a facet both are linear, and the radar's direction is the same to micrometres. A piece is
what one pixel cuts out of one facet.
"""

import warp as wp

Corners = wp.types.matrix(shape=(8, 2), dtype=wp.float64)
"""A polygon's corners (line, slant range): a triangle cut by four straight lines has seven."""

THIN = wp.constant(wp.float64(1.0e-3))
"""Least width of a facet in the image, in pixels: one that is seen edge on has no area to share out."""
GRAZING = wp.constant(1.0e-4)
"""Cosine of incidence below which a facet counts as turned away."""
EDGE_ON = wp.constant(0.01)
"""Cosine of incidence below which a facet may hide others: `GRAZING`, with room for directions of other facets."""
FULL_TURN = wp.constant(1.5707963267948966)


@wp.struct
class GroundFacets:
    """The ground: corners of posts by their number, and triangles of three posts, counter-clockwise from outside.

    Lines count from the first of the block; slant ranges [m] from `PixelEdges.start_m`.
    """

    points: wp.array(dtype=wp.vec3)  # [m], local
    corners: wp.array(dtype=int)  # (3 n,)
    line: wp.array(dtype=wp.float64)
    slant: wp.array(dtype=wp.float64)
    look: wp.array(dtype=wp.vec3)  # unit vector to the radar
    cover: wp.array(dtype=int)  # of each triangle: the row of `Backscatter.sigma0`; -1: by the raster of classes
    place: wp.array(dtype=wp.vec2)  # of each post in that raster: column and row, whole numbers are cells' corners
    ground: int  # triangles of the ground; those after them are buildings
    forward: wp.float64  # sign of a level triangle's area in (line, slant range)


@wp.struct
class PixelEdges:
    """Where pixels begin and end in slant range [m] from `start_m`: (lines, pixels + 1), rising."""

    slant: wp.array2d(dtype=float)


@wp.struct
class Backscatter:
    """sigma0 (linear) of each cover at equal steps of incidence from 0 to 90 degrees: (covers, n)."""

    sigma0: wp.array2d(dtype=float)
    classes: wp.array2d(dtype=int)  # (rows, columns): the row of `sigma0`


@wp.struct
class PixelSums:
    """Sums over the pieces of each pixel, (lines, pixels)."""

    area: wp.array2d(dtype=float)  # lit area [m2]
    across: wp.array2d(dtype=float)  # lit area seen from the radar [m2]
    power: wp.array2d(dtype=float)  # sigma0 times lit area [m2]
    surfaces: wp.array2d(dtype=float)  # lit pieces, each by its share of the pixel
    folded: wp.array2d(dtype=float)  # those of them whose far side is nearer to the radar
    covered: wp.array2d(dtype=float)  # pieces of the ground by share, folded ones negative: 1 where there is ground
    place: wp.array2d(dtype=wp.int64)  # power's density at the middle (its bits) and the facet that has it; 0: none


@wp.func
def sigma0_at(backscatter: Backscatter, cover: int, cosine: float) -> float:
    count = backscatter.sigma0.shape[1]
    at = wp.acos(wp.clamp(cosine, 0.0, 1.0)) / FULL_TURN * float(count - 1)
    i = wp.min(int(at), count - 2)
    share = at - float(i)
    return (1.0 - share) * backscatter.sigma0[cover, i] + share * backscatter.sigma0[cover, i + 1]


@wp.func
def cover_at(facets: GroundFacets, backscatter: Backscatter, f: int, weights: wp.vec3d) -> int:
    """The row of `sigma0` at a place of a facet, by its barycentric weights."""
    if facets.cover[f] >= 0:
        return facets.cover[f]
    at = wp.vec2(0.0, 0.0)
    for corner in range(3):
        at += float(weights[corner]) * facets.place[facets.corners[3 * f + corner]]
    column = wp.clamp(int(wp.floor(at[0])), 0, backscatter.classes.shape[1] - 1)
    row = wp.clamp(int(wp.floor(at[1])), 0, backscatter.classes.shape[0] - 1)
    return backscatter.classes[row, column]


@wp.func
def cut(shape: Corners, count: int, axis: int, at: wp.float64, keep: wp.float64):
    """The corners on one side of a straight line (Sutherland and Hodgman 1974): keep (x - at) >= 0."""
    made = Corners()
    n = int(0)
    for i in range(count):
        j = i + 1
        if j == count:
            j = 0
        here = keep * (shape[i, axis] - at)
        there = keep * (shape[j, axis] - at)
        if here >= wp.float64(0.0):
            made[n, 0] = shape[i, 0]
            made[n, 1] = shape[i, 1]
            n += 1
        if (here > wp.float64(0.0) and there < wp.float64(0.0)) or (here < wp.float64(0.0) and there > wp.float64(0.0)):
            t = here / (here - there)
            made[n, 0] = shape[i, 0] + t * (shape[j, 0] - shape[i, 0])
            made[n, 1] = shape[i, 1] + t * (shape[j, 1] - shape[i, 1])
            n += 1
    return made, n


@wp.func
def area_and_middle(shape: Corners, count: int) -> wp.vec3d:
    """Signed area, and the centroid, of a polygon; area 0 where there is none."""
    area = wp.float64(0.0)
    x = wp.float64(0.0)
    y = wp.float64(0.0)
    for i in range(1, count - 1):
        u0 = shape[i, 0] - shape[0, 0]
        u1 = shape[i, 1] - shape[0, 1]
        v0 = shape[i + 1, 0] - shape[0, 0]
        v1 = shape[i + 1, 1] - shape[0, 1]
        part = wp.float64(0.5) * (u0 * v1 - u1 * v0)
        area += part
        x += part * (u0 + v0) / wp.float64(3.0)
        y += part * (u1 + v1) / wp.float64(3.0)
    if area != wp.float64(0.0):
        x = x / area
        y = y / area
    return wp.vec3d(area, shape[0, 0] + x, shape[0, 1] + y)


@wp.func
def pixel_at(edges: PixelEdges, line: int, slant: float) -> int:
    """The last pixel that begins at or before a slant range; -1 before the first."""
    low = int(-1)
    high = edges.slant.shape[1]
    while high - low > 1:
        middle = (low + high) / 2
        if edges.slant[line, middle] <= slant:
            low = middle
        else:
            high = middle
    return low


@wp.func
def weights_at(shape: Corners, line: wp.float64, slant: wp.float64) -> wp.vec3d:
    """Barycentric weights of a place in the image, by the first three corners."""
    u0 = shape[1, 0] - shape[0, 0]
    u1 = shape[1, 1] - shape[0, 1]
    v0 = shape[2, 0] - shape[0, 0]
    v1 = shape[2, 1] - shape[0, 1]
    p0 = line - shape[0, 0]
    p1 = slant - shape[0, 1]
    whole = u0 * v1 - u1 * v0
    b = (p0 * v1 - p1 * v0) / whole
    c = (u0 * p1 - u1 * p0) / whole
    return wp.vec3d(wp.float64(1.0) - b - c, b, c)


@wp.func
def in_image(facets: GroundFacets, i: int, j: int, k: int, pixel_m: wp.float64) -> Corners:
    """A facet's triangle in the image. One that is thinner than `THIN` is widened by that, about in slant range."""
    shape = Corners()
    shape[0, 0] = facets.line[i]
    shape[0, 1] = facets.slant[i]
    shape[1, 0] = facets.line[j]
    shape[1, 1] = facets.slant[j]
    shape[2, 0] = facets.line[k]
    shape[2, 1] = facets.slant[k]
    ab = shape[1, 0] - shape[0, 0]
    ac = shape[2, 0] - shape[0, 0]
    doubled = ab * (shape[2, 1] - shape[0, 1]) - ac * (shape[1, 1] - shape[0, 1])
    least = THIN * pixel_m * wp.max(wp.abs(ab), wp.abs(ac))
    if wp.abs(doubled) < least:
        wanted = least
        if doubled < wp.float64(0.0):
            wanted = -least
        if wp.abs(ab) > wp.abs(ac):
            shape[2, 1] = shape[2, 1] + (wanted - doubled) / ab
        else:
            shape[1, 1] = shape[1, 1] - (wanted - doubled) / ac
    return shape


@wp.kernel(enable_backward=False)
def hiding_kernel(
    # In:
    facets: GroundFacets,
    # Out:
    hides_out: wp.array(dtype=wp.uint8),
):
    """Which triangles can be the first that a ray to the radar meets.

    A ray that starts above the ground goes into it through a facet that is turned away from the radar: where it goes,
    it meets the others from below. A ray may start inside a building, and then leaves it: all of its facets count.
    """
    f = wp.tid()
    i = facets.corners[3 * f]
    j = facets.corners[3 * f + 1]
    k = facets.corners[3 * f + 2]
    a = facets.points[i]
    normal = wp.normalize(wp.cross(facets.points[j] - a, facets.points[k] - a))
    look = wp.normalize(facets.look[i] + facets.look[j] + facets.look[k])
    if f >= facets.ground or wp.dot(normal, look) < EDGE_ON:
        hides_out[f] = wp.uint8(1)


@wp.func
def sees_radar(tree: wp.uint64, point: wp.vec3, normal: wp.vec3, look: wp.vec3, clear_m: float, reach_m: float) -> bool:
    """Whether a point of a facet sees the radar. Its ray starts above the facet: where another one that is turned away
    begins at the point, a ray that started along the look would be below it, and meet nothing."""
    return not wp.mesh_query_ray_anyhit(tree, point + clear_m * normal, look, reach_m)


# One thread walks through a facet's pixels: what is cut out would be handed twenty values and back.
@wp.kernel(enable_backward=False)
def project_kernel(
    # In:
    facets: GroundFacets,
    edges: PixelEdges,
    backscatter: Backscatter,
    tree: wp.uint64,
    pixel_m: wp.float64,
    clear_m: float,
    reach_m: float,
    # In and out:
    sums: PixelSums,
):
    f = wp.tid()
    i = facets.corners[3 * f]
    j = facets.corners[3 * f + 1]
    k = facets.corners[3 * f + 2]
    lines = edges.slant.shape[0]
    pixels = edges.slant.shape[1] - 1
    half = wp.float64(0.5)
    low = wp.min(facets.line[i], wp.min(facets.line[j], facets.line[k]))
    high = wp.max(facets.line[i], wp.max(facets.line[j], facets.line[k]))
    first = wp.max(int(wp.floor(low + half)), 0)
    last = wp.min(int(wp.floor(high + half)), lines - 1)
    if first > last:
        return
    a = facets.points[i]
    b = facets.points[j]
    c = facets.points[k]
    doubled = wp.cross(b - a, c - a)
    facet_m2 = 0.5 * wp.length(doubled)
    if facet_m2 <= 0.0 or high - low < wp.float64(1.0e-9):
        return
    look = wp.normalize(facets.look[i] + facets.look[j] + facets.look[k])
    cosine = wp.dot(doubled, look) / (2.0 * facet_m2)
    whole = in_image(facets, i, j, k, pixel_m)
    image = area_and_middle(whole, 3)[0]
    folded = image * facets.forward < wp.float64(0.0)
    density = facet_m2 / float(wp.abs(image))  # [m2] of ground for an area of one line by one metre
    for line in range(first, last + 1):
        strip = whole  # a cut that leaves all there costs as much as one that does not
        n = int(3)
        if low < wp.float64(line) - half:
            strip, n = cut(strip, n, 0, wp.float64(line) - half, wp.float64(1.0))
        if high > wp.float64(line) + half:
            strip, n = cut(strip, n, 0, wp.float64(line) + half, wp.float64(-1.0))
        if n < 3:
            continue
        near = strip[0, 1]
        far = strip[0, 1]
        for at in range(1, n):
            near = wp.min(near, strip[at, 1])
            far = wp.max(far, strip[at, 1])
        pixel = wp.max(pixel_at(edges, line, float(near)), 0)
        while pixel < pixels and edges.slant[line, pixel] < float(far):
            begin = edges.slant[line, pixel]
            end = edges.slant[line, pixel + 1]
            piece = strip
            m = n
            if near < wp.float64(begin):
                piece, m = cut(piece, m, 1, wp.float64(begin), wp.float64(1.0))
            if far > wp.float64(end):
                piece, m = cut(piece, m, 1, wp.float64(end), wp.float64(-1.0))
            if m > 2:
                found = area_and_middle(piece, m)
                cell = float(wp.abs(found[0]))
                share = cell / (end - begin)
                lit = cosine > GRAZING
                if lit and cell > 0.0:
                    w = weights_at(whole, found[1], found[2])
                    point = float(w[0]) * a + float(w[1]) * b + float(w[2]) * c
                    lit = sees_radar(tree, point, doubled / (2.0 * facet_m2), look, clear_m, reach_m)
                if lit:
                    inside = weights_at(whole, found[1], found[2])
                    sigma0 = sigma0_at(backscatter, cover_at(facets, backscatter, f, inside), cosine)
                    ground = cell * density
                    wp.atomic_add(sums.area, line, pixel, ground)
                    wp.atomic_add(sums.across, line, pixel, ground * cosine)
                    wp.atomic_add(sums.power, line, pixel, ground * sigma0)
                    wp.atomic_add(sums.surfaces, line, pixel, share)
                    if folded:
                        wp.atomic_add(sums.folded, line, pixel, share)
                    w = weights_at(whole, wp.float64(line), wp.float64(0.5 * (begin + end)))
                    if wp.min(w[0], wp.min(w[1], w[2])) >= wp.float64(-1.0e-9):
                        bits = wp.int64(wp.cast(density * sigma0 + 1.0e-30, wp.int32))
                        wp.atomic_max(sums.place, line, pixel, (bits << wp.int64(32)) + wp.int64(f) + wp.int64(1))
                if f < facets.ground:
                    if folded:
                        wp.atomic_add(sums.covered, line, pixel, -share)
                    else:
                        wp.atomic_add(sums.covered, line, pixel, share)
            pixel += 1


@wp.struct
class PostPlaces:
    """Of each post: longitude and latitude [deg] from the block's own, height [m], and the ellipsoid's normal."""

    longitude: wp.array(dtype=wp.float64)
    latitude: wp.array(dtype=wp.float64)
    height: wp.array(dtype=wp.float64)
    up: wp.array(dtype=wp.vec3)


@wp.kernel(enable_backward=False)
def place_kernel(
    # In:
    facets: GroundFacets,
    posts: PostPlaces,
    edges: PixelEdges,
    place: wp.array2d(dtype=wp.int64),
    backscatter: Backscatter,
    pixel_m: wp.float64,
    # Out:
    longitude_out: wp.array2d(dtype=wp.float64),
    latitude_out: wp.array2d(dtype=wp.float64),
    height_out: wp.array2d(dtype=float),
    incidence_out: wp.array2d(dtype=float),
    ellipsoid_incidence_out: wp.array2d(dtype=float),
    cover_out: wp.array2d(dtype=float),
):
    """What lies at each pixel's middle: angles in degrees; NaN where nothing is lit."""
    line, pixel = wp.tid()
    key = place[line, pixel]
    if key == wp.int64(0):
        nothing = wp.nan
        longitude_out[line, pixel] = wp.float64(nothing)
        latitude_out[line, pixel] = wp.float64(nothing)
        height_out[line, pixel] = nothing
        incidence_out[line, pixel] = nothing
        ellipsoid_incidence_out[line, pixel] = nothing
        cover_out[line, pixel] = nothing
        return
    f = int(key & wp.int64(4294967295)) - 1
    i = facets.corners[3 * f]
    j = facets.corners[3 * f + 1]
    k = facets.corners[3 * f + 2]
    middle = wp.float64(0.5 * (edges.slant[line, pixel] + edges.slant[line, pixel + 1]))
    w = weights_at(in_image(facets, i, j, k, pixel_m), wp.float64(line), middle)
    longitude_out[line, pixel] = w[0] * posts.longitude[i] + w[1] * posts.longitude[j] + w[2] * posts.longitude[k]
    latitude_out[line, pixel] = w[0] * posts.latitude[i] + w[1] * posts.latitude[j] + w[2] * posts.latitude[k]
    height_out[line, pixel] = float(w[0] * posts.height[i] + w[1] * posts.height[j] + w[2] * posts.height[k])
    look = wp.normalize(facets.look[i] + facets.look[j] + facets.look[k])
    a = facets.points[i]
    normal = wp.normalize(wp.cross(facets.points[j] - a, facets.points[k] - a))
    incidence_out[line, pixel] = wp.degrees(wp.acos(wp.clamp(wp.dot(normal, look), -1.0, 1.0)))
    here = wp.normalize(float(w[0]) * facets.look[i] + float(w[1]) * facets.look[j] + float(w[2]) * facets.look[k])
    up = wp.normalize(float(w[0]) * posts.up[i] + float(w[1]) * posts.up[j] + float(w[2]) * posts.up[k])
    ellipsoid_incidence_out[line, pixel] = wp.degrees(wp.acos(wp.clamp(wp.dot(up, here), -1.0, 1.0)))
    cover_out[line, pixel] = float(cover_at(facets, backscatter, f, w))


@wp.struct
class MapGrid:
    """Cells of the map: those of the elevation model, `fine` by `fine` of them about each post.

    `facet`, (rows - 1, columns - 1): the first of two triangles between four posts, the one at the first row and
    column; -1 for none. `turned`: whether the order of their corners is turned over; `backwards`: whether pixels are
    counted from the far end of `PixelEdges`.
    """

    facet: wp.array2d(dtype=int)
    fine: int
    turned: int
    backwards: int


@wp.struct
class CellPlaces:
    """Of each cell, (rows, columns); but for `pixel` nothing is said of one that does not lie in the block."""

    pixel: wp.array2d(dtype=int)  # the one that shows it: line times pixels in a line, plus pixel; -1: none
    line_at: wp.array2d(dtype=wp.float64)  # fractional
    pixel_at: wp.array2d(dtype=wp.float64)
    incidence: wp.array2d(dtype=float)  # [deg]
    lit: wp.array2d(dtype=wp.uint8)
    folded: wp.array2d(dtype=wp.uint8)  # its facet lies over others


@wp.func
def between_posts(at: int, fine: int) -> wp.float64:
    """Where a cell's middle lies, in posts from the first one."""
    return (wp.float64(at) + wp.float64(0.5)) / wp.float64(fine) - wp.float64(0.5)


@wp.kernel(enable_backward=False)
def map_kernel(
    # In:
    grid: MapGrid,
    facets: GroundFacets,
    edges: PixelEdges,
    tree: wp.uint64,
    clear_m: float,
    reach_m: float,
    # Out:
    cells_out: CellPlaces,
):
    row, column = wp.tid()
    cells_out.pixel[row, column] = -1
    down = between_posts(row, grid.fine)
    along = between_posts(column, grid.fine)
    top = int(wp.floor(down))
    left = int(wp.floor(along))
    if top < 0 or top >= grid.facet.shape[0] or left < 0 or left >= grid.facet.shape[1]:
        return
    f = grid.facet[top, left]
    if f < 0:
        return
    one = wp.float64(1.0)
    down -= wp.float64(top)
    along -= wp.float64(left)
    second = down  # weights of the triangle's corners
    third = along
    if down + along > one:
        f += 1
        second = one - along
        third = down + along - one
    if grid.turned > 0:
        third = one - second - third
    v = float(second)
    w = float(third)
    i = facets.corners[3 * f]
    j = facets.corners[3 * f + 1]
    k = facets.corners[3 * f + 2]
    u = 1.0 - v - w
    line = wp.float64(u) * facets.line[i] + wp.float64(v) * facets.line[j] + wp.float64(w) * facets.line[k]
    slant = wp.float64(u) * facets.slant[i] + wp.float64(v) * facets.slant[j] + wp.float64(w) * facets.slant[k]
    lines = edges.slant.shape[0]
    pixels = edges.slant.shape[1] - 1
    nearest = int(wp.floor(line + wp.float64(0.5)))
    if nearest < 0 or nearest >= lines:
        return
    pixel = pixel_at(edges, nearest, float(slant))
    if pixel < 0 or pixel >= pixels:
        return
    begin = wp.float64(edges.slant[nearest, pixel])
    end = wp.float64(edges.slant[nearest, pixel + 1])
    at = wp.float64(pixel) - wp.float64(0.5) + (slant - begin) / (end - begin)
    if grid.backwards > 0:
        at = wp.float64(pixels - 1) - at
    cells_out.pixel[row, column] = nearest * pixels + wp.clamp(int(wp.floor(at + wp.float64(0.5))), 0, pixels - 1)
    cells_out.line_at[row, column] = line
    cells_out.pixel_at[row, column] = at
    a = facets.points[i]
    b = facets.points[j]
    c = facets.points[k]
    normal = wp.normalize(wp.cross(b - a, c - a))
    look = wp.normalize(u * facets.look[i] + v * facets.look[j] + w * facets.look[k])
    cosine = wp.dot(normal, look)
    cells_out.incidence[row, column] = wp.degrees(wp.acos(wp.clamp(cosine, -1.0, 1.0)))
    cells_out.lit[row, column] = wp.uint8(0)
    if cosine > GRAZING:
        if sees_radar(tree, u * a + v * b + w * c, normal, look, clear_m, reach_m):
            cells_out.lit[row, column] = wp.uint8(1)
    ab = (facets.line[j] - facets.line[i]) * (facets.slant[k] - facets.slant[i])
    ac = (facets.line[k] - facets.line[i]) * (facets.slant[j] - facets.slant[i])
    cells_out.folded[row, column] = wp.uint8(0)
    if (ab - ac) * facets.forward < wp.float64(0.0):
        cells_out.folded[row, column] = wp.uint8(1)
