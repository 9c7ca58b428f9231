"""Write the meshes and scene files of data/coherent: bodies whose radar cross-section has a closed form, and a duct.

Run as `python data/make_coherent.py`; what it writes is committed, and the same to the byte in every run. Lengths are
whole wavelengths at 10 GHz (3 cm). X is east, Y north, Z up, all in metres.
"""

from pathlib import Path

FOLDER = Path(__file__).parent / "coherent"
WAVELENGTH_M = 0.03
MESH = """[scene]
mesh = "{name}.obj"
"""
SPHERE = """[scene]                           # its body is an object

[[objects]]
primitive = "sphere"
size_m = [{size:g}, {size:g}, {size:g}]
position_m = [0.0, 0.0, {foot:g}]    # of its lowest point
material = "body"
"""

Point = tuple[float, float, float]
Faces = list[tuple[Point, ...]]

SCENE = """# {about}
{body}
[radar]
frequency_hz = 9993081933.333334  # a wavelength of 3 cm
polarizations = ["HH", "VV"]

[image]                           # for `warpsar view`; `warpsar rcs` needs no image
shape = [64, 64]
spacing_m = [0.05, 0.05]

[materials.body]
conductor = true

[[views]]
name = "one"
azimuth_deg = 0.0
incidence_deg = 45.0
"""


def plate(width: float, height: float) -> Faces:
    """Upright, facing east and west."""
    y, z = width / 2, height / 2
    return [((0, -y, -z), (0, y, -z), (0, y, z), (0, -y, z))]


def dihedral(a: float, b: float) -> Faces:
    """Two upright plates that meet in the vertical axis; it opens to the north-east."""
    return [((0, 0, 0), (a, 0, 0), (a, 0, b), (0, 0, b)), ((0, 0, 0), (0, a, 0), (0, a, b), (0, 0, b))]


def trihedral(a: float) -> Faces:
    """Three triangles; it opens to the north-east and up, its axis at an incidence of 54.7356 degrees."""
    return [((0, 0, 0), (a, 0, 0), (0, a, 0)), ((0, 0, 0), (0, a, 0), (0, 0, a)), ((0, 0, 0), (0, 0, a), (a, 0, 0))]


def duct(width: float, depth: float) -> Faces:
    """A square tube, open to the north, with a wall at its end."""
    x = z = width / 2
    corners = [(-x, -z), (x, -z), (x, z), (-x, z)]
    sides: Faces = [
        ((a[0], 0, a[1]), (b[0], 0, b[1]), (b[0], -depth, b[1]), (a[0], -depth, a[1]))
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    return [*sides, tuple((a[0], -depth, a[1]) for a in corners)]


def write_mesh(name: str, about: str, faces: Faces) -> None:
    numbers: dict[Point, int] = {}
    lines = [f"# {about}", "usemtl body"]
    for face in faces:
        for point in face:
            place = tuple(round(x, 9) + 0.0 for x in point)
            if place not in numbers:
                numbers[place] = len(numbers) + 1  # type: ignore[index]
                lines.append("v " + " ".join(f"{x:.9g}" for x in place))
    for face in faces:
        lines.append("f " + " ".join(str(numbers[tuple(round(x, 9) + 0.0 for x in p)]) for p in face))  # type: ignore[index]
    (FOLDER / f"{name}.obj").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    write_scene(name, about, MESH.format(name=name))


def write_scene(name: str, about: str, body: str) -> None:
    (FOLDER / f"{name}.toml").write_text(SCENE.format(about=about, body=body), encoding="utf-8", newline="\n")


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    unit = WAVELENGTH_M
    write_mesh("plate", "A conducting plate, 5 x 7 wavelengths.", plate(5 * unit, 7 * unit))
    write_mesh("dihedral", "A conducting dihedral of two plates, 10 x 8 wavelengths.", dihedral(10 * unit, 8 * unit))
    write_mesh("trihedral", "A conducting triangular trihedral with legs of 10 wavelengths.", trihedral(10 * unit))
    ball = SPHERE.format(size=10 * unit, foot=-5 * unit)
    write_scene("sphere", "A conducting sphere with a radius of 5 wavelengths.", ball)
    write_mesh("duct", "A conducting square duct, 10 wavelengths wide and 10 deep.", duct(10 * unit, 10 * unit))


if __name__ == "__main__":
    main()
