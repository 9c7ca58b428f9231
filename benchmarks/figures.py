"""The pictures of the docs that our own scenes and formulas make; `gallery.py` makes those of docs/gallery.md.

    python benchmarks/figures.py collection       # docs/collections.md: a complex image, an interferogram
    python benchmarks/figures.py concepts         # docs/concepts.md: a building in slant range, speckle by its looks
    python benchmarks/figures.py effects [NAME]   # docs/effects.md: the example without and with each effect
    python benchmarks/figures.py objects          # docs/objects.md: each primitive, as triangles and as an image
    python benchmarks/figures.py paper            # docs/physics.md: figures 3 and 4 of the method's paper
    python benchmarks/figures.py getting-started OUT    # docs/getting-started.md and README.md

They go to docs/figures, or to `--out`. OUT holds what the commands of docs/getting-started.md left there.
"""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray
from objects import CPU, plain, with_one
from PIL import Image, ImageDraw
from scenes import EXAMPLE, example_with

import warpsar
from warpsar.collection.slc import Slc
from warpsar.differentiable.geometry import exact_images
from warpsar.effects.registry import get, names
from warpsar.io.figures import new, save
from warpsar.simulation.materials import sigma0_db

DATA = EXAMPLE.parent.parent
FIGURES = DATA.parent / "docs" / "figures"
FOLDER = click.Path(file_okay=False, path_type=Path)
out_option = click.option("-o", "--out", default=FIGURES, show_default="docs/figures", type=FOLDER)


@click.group()
def main() -> None:
    """The pictures of the docs."""


def decibels(power: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(power.astype(float)))


def as_webp(figure: Figure, path: Path) -> None:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=95)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.open(stream).convert("RGB").save(path, quality=65, method=6)


# ---- a collection ----

BASELINE = 0.06
"""Between two passes, as an angle of incidence [deg]: a fringe is then 10 m of height."""


def image_figure(path: Path, made: Slc, ground: np.ndarray) -> None:
    """Power in dB; the spectrum in dB; and a histogram of power over its mean on even `ground`, beside exp(-x)."""
    (image,) = made.images.values()
    figure, axes = new(11.0, 3.6, ncols=3)
    power = np.abs(image) ** 2
    extent = (*made.azimuth_m[[0, -1]], *made.range_m[[-1, 0]])
    axes[0].imshow(10 * np.log10(power + 1e-12), extent=extent, cmap="gray", vmin=-35, vmax=0)
    axes[0].set(xlabel="azimuth [m]", ylabel="slant range [m]", title="beta0 of one image [dB]")
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(image))) ** 2
    steps = [axis[1] - axis[0] for axis in (made.range_m, made.azimuth_m)]
    ends = (-0.5 / steps[1], 0.5 / steps[1], 0.5 / steps[0], -0.5 / steps[0])
    shown = 10 * np.log10(spectrum / spectrum.max() + 1e-9)
    axes[1].imshow(shown, extent=ends, cmap="viridis", vmin=-50, vmax=0)
    axes[1].set(xlabel="azimuth frequency [1/m]", ylabel="range frequency [1/m]", title="spectrum [dB]")
    seen = power[ground] / power[ground].mean()
    axes[2].hist(seen, bins=40, range=(0, 6), density=True, color="0.7")
    x = np.linspace(0, 6, 100)
    axes[2].plot(x, np.exp(-x), "k", lw=1)
    axes[2].set(xlabel="power over its mean", ylabel="density", yscale="log", title="lawn, and exp(-x)")
    save(figure, path)


def interferogram_figure(path: Path, one: Slc, two: Slc) -> None:
    """Phase of two passes without the level plane's, and their coherence over 5 x 5 pixels."""
    from scipy.ndimage import uniform_filter

    first, second = (next(iter(made.images.values())).astype(complex) for made in (one, two))
    plane = []
    for made in (one, two):  # a point of the level plane at one slant range of the first pass
        slant = one.range_m[:, None]
        outward = np.array([*one.plan.geometry.d[:2], 0.0]) / np.hypot(*one.plan.geometry.d[:2]) ** 2
        points = slant[..., None] * outward + one.azimuth_m[None, :, None] * one.plan.geometry.u
        ways = made.plan.track.centre().ranges_less_reference(points.reshape(-1, 3), np.array([0]))[0]
        plane.append(ways.reshape(first.shape))
    turns = 2.0 * one.plan.centre_hz / 299792458.0 * (plane[0] - plane[1])
    product = first * second.conj() * np.exp(2j * np.pi * turns)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(uniform_filter(values.real, 5) + 1j * uniform_filter(values.imag, 5))

    smooth = mean(product)
    coherence = np.abs(smooth) / np.sqrt(mean(np.abs(first) ** 2).real * mean(np.abs(second) ** 2).real)
    extent = (*one.azimuth_m[[0, -1]], *one.range_m[[-1, 0]])
    figure, axes = new(8.4, 3.9, ncols=2)
    shown = axes[0].imshow(np.angle(smooth), extent=extent, cmap="twilight", vmin=-np.pi, vmax=np.pi)
    figure.colorbar(shown, ax=axes[0], label="phase [rad]")
    shown = axes[1].imshow(coherence, extent=extent, cmap="gray", vmin=0, vmax=1)
    figure.colorbar(shown, ax=axes[1], label="coherence")
    for axis in axes:
        axis.set(xlabel="azimuth [m]", ylabel="slant range [m]")
    save(figure, path)


@main.command()
@out_option
@click.option("--device")
def collection(out: Path, device: str | None) -> None:
    """A complex image with its spectrum and histogram, and an interferogram."""
    scene = warpsar.Scene.load(DATA / "collection" / "scene.toml")
    (one,) = warpsar.slc(scene, device=device)
    layers = warpsar.simulate(scene, device=device, layers=True)[0].layers
    lawn = list(scene.mesh.materials).index("lawn")
    image_figure(out / "collection_slc.png", one, (layers["material"] == lawn) & (layers["layover"] == 1))
    view = scene.views[0]
    other = view.model_copy(update={"name": "again", "stated_incidence_deg": view.incidence_deg + BASELINE})
    first, second = warpsar.slc(replace(scene, views=[view, other]), device=device)
    interferogram_figure(out / "collection_interferogram.png", first, second)


# ---- concepts ----

INCIDENCE = np.radians(45.0)
WIDTH_M, HEIGHT_M = 10.0, 8.0  # of the building, whose wall stands at x = 0
NEAR_M, FAR_M = -16.0, 28.0
COLOURS = {"ground": "#5a8f4f", "wall": "#b5523b", "roof": "#4a6fa5", "corner": "#c98a00", "shadow": "#333333"}


def slant_range(x: Any, z: Any) -> Any:
    """Of a point of the drawing about the foot of the wall [m]; a plane wave comes from the upper left."""
    return x * np.sin(INCIDENCE) - z * np.cos(INCIDENCE)


def section(axis: Any) -> None:
    """The building from the side, coloured by what each part becomes in the image."""
    shadow_end = WIDTH_M + HEIGHT_M * np.tan(INCIDENCE)
    axis.fill_between([0, WIDTH_M], 0, HEIGHT_M, color="#eeeeee")
    axis.fill([WIDTH_M, WIDTH_M, shadow_end], [HEIGHT_M, 0, 0], color="#dddddd")
    for xs in ([NEAR_M, 0.0], [shadow_end, FAR_M]):
        axis.plot(xs, [0, 0], color=COLOURS["ground"], lw=4)
    axis.plot([WIDTH_M, shadow_end], [0, 0], color=COLOURS["shadow"], lw=4)
    axis.plot([0, 0], [0, HEIGHT_M], color=COLOURS["wall"], lw=4)
    axis.plot([0, WIDTH_M], [HEIGHT_M, HEIGHT_M], color=COLOURS["roof"], lw=4)
    axis.plot([WIDTH_M, WIDTH_M], [0, HEIGHT_M], color=COLOURS["shadow"], lw=2)
    axis.plot(0, 0, "o", color=COLOURS["corner"], ms=9, zorder=5)
    along, front = np.array([np.sin(INCIDENCE), -np.cos(INCIDENCE)]), np.array([np.cos(INCIDENCE), np.sin(INCIDENCE)])
    for distance in (-slant_range(0, HEIGHT_M) * np.array([-1.0, 0.0])).tolist():  # through the eaves, through the foot
        ends = np.array([along * distance + front * t for t in (-22.0, 22.0)])
        axis.plot(*ends.T, "--", color="#888888", lw=1)
    for start in ((-14.0, 17.0), (-10.0, 17.0), (-6.0, 17.0)):
        axis.annotate("", np.array(start) + 4 * along, start, arrowprops={"arrowstyle": "->", "color": "#555555"})
    axis.text(-15.5, 13.2, "from\nthe radar", fontsize=8, color="#555555", va="top")
    axis.text(5, 4, "building", ha="center", fontsize=9)
    axis.text(WIDTH_M + 2.2, 1.6, "shadow", fontsize=9)
    axis.text(12.5, 10.0, "dashed: all points of one slant range", fontsize=8, color="#555555")
    axis.text(0.5, -2.6, "corner: two bounces", fontsize=8, color=COLOURS["corner"])
    axis.set(xlim=(NEAR_M, FAR_M), ylim=(-4, 18), xlabel="ground range [m]", ylabel="height [m]", aspect="equal")
    axis.set_title("the building from the side", fontsize=10)


def row(axis: Any) -> None:
    """What of it falls into which slant range."""
    shadow_end = WIDTH_M + HEIGHT_M * np.tan(INCIDENCE)
    parts = [
        ("roof", slant_range(0, HEIGHT_M), slant_range(WIDTH_M, HEIGHT_M)),
        ("wall", slant_range(0, HEIGHT_M), slant_range(0, 0)),
        ("ground", slant_range(NEAR_M, 0), slant_range(0, 0)),
        ("ground", slant_range(shadow_end, 0), slant_range(FAR_M, 0)),
        ("shadow", slant_range(WIDTH_M, HEIGHT_M), slant_range(shadow_end, 0)),
    ]
    heights = {"ground": 0, "wall": 1, "roof": 2, "shadow": 0}
    for name, start, end in parts:
        fill = {"facecolor": "white", "hatch": "////"} if name == "shadow" else {"facecolor": COLOURS[name]}
        axis.barh(heights[name], end - start, left=start, height=0.7, edgecolor=COLOURS[name], **fill)
    axis.barh(3, 0.6, left=-0.3, height=0.7, color=COLOURS["corner"])
    axis.text(0.6, 3, "bright line at the foot of the wall", fontsize=8, va="center")
    left, right = slant_range(0, HEIGHT_M), 0.0
    axis.axvspan(left, right, color="#f3e3c0", zorder=0)
    axis.text((left + right) / 2, 3.75, "layover", ha="center", fontsize=9)
    axis.text(slant_range(WIDTH_M + 3, HEIGHT_M / 2), 0.55, "shadow: nothing comes back", fontsize=8)
    axis.set_yticks([0, 1, 2, 3], ["ground", "wall", "roof", "corner"])
    axis.set(xlim=(slant_range(NEAR_M, 0), slant_range(FAR_M, 0)), ylim=(-0.6, 4.4))
    axis.set_xlabel("slant range about the foot of the wall [m]; pixels are cut along it")
    axis.set_title("where its parts lie in the image", fontsize=10)


def speckle(figure: Figure, axes: Any) -> None:
    """The same even ground with 1, 4 and 16 looks."""
    random = np.random.default_rng(3)
    for axis, looks in zip(axes, (1, 4, 16), strict=True):
        decibel = 10.0 * np.log10(random.gamma(looks, 1.0 / looks, (48, 48)))
        drawn = axis.imshow(decibel, "gray", vmin=-15.0, vmax=6.0)
        axis.set_title(f"{looks} look{'s' if looks > 1 else ''}", fontsize=10)
        axis.set_xlabel("azimuth [pixels]", fontsize=8)
        axis.tick_params(labelsize=7)
    axes[0].set_ylabel("slant range [pixels]", fontsize=8)
    figure.colorbar(drawn, ax=list(axes), shrink=0.8, extend="both").set_label("power over its mean [dB]", fontsize=8)


@main.command()
@out_option
def concepts(out: Path) -> None:
    """A building in slant range, and speckle by its looks."""
    figure, axes = new(7.6, 6.6, nrows=2, gridspec_kw={"height_ratios": [3, 2]})
    section(axes[0])
    row(axes[1])
    figure.savefig(out / "concept_building.png", dpi=100)
    figure, axes = new(8.4, 3.0, ncols=3)
    speckle(figure, axes)
    figure.savefig(out / "concept_looks.png", dpi=100)


# ---- effects ----


def seen_with(name: str | None) -> tuple[warpsar.Scene, NDArray[Any]]:
    """The example seen along its walls, in a second of CPU time; with one effect, or with none; and its image."""
    scene = example_with(name, 64.0)
    scene = replace(
        scene,
        views=[view.model_copy(update={"azimuth_deg": 2.0}) for view in scene.views],
        radar=scene.radar.model_copy(update={"polarizations": ("HH",)}),
    )
    return scene, warpsar.simulate(scene, device="cpu")[0].beta0["HH"]


@main.command()
@out_option
@click.argument("chosen", nargs=-1, metavar="[NAME]...", type=click.Choice(list(names())))
def effects(out: Path, chosen: tuple[str, ...]) -> None:
    """The example without each effect, with it (`Effect.example` says with which values), and the ratio of the two."""
    _, without = seen_with(None)
    low, high = np.percentile(decibels(without[without > 0]), [2, 99.5])
    for name in chosen or names():
        scene, with_it = seen_with(name)
        half = [n * step / 2 for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)]
        extent = (-half[1], half[1], half[0], -half[0])
        figure, axes = new(10.5, 3.7, ncols=3)
        for axis, image, title in zip(axes, (without, with_it), ("without", "with"), strict=False):
            axis.set_facecolor("black")  # no power at all
            grey = axis.imshow(decibels(image), cmap="gray", vmin=low - 6, vmax=high + 6, extent=extent)
            axis.set_title(f"{title} {name}")
        figure.colorbar(grey, ax=axes[:2], label="beta0 [dB]", shrink=0.85)
        with np.errstate(invalid="ignore"):
            ratio = np.where(with_it == without, 0.0, decibels(with_it) - decibels(without))
        largest = np.clip(np.percentile(np.abs(ratio[np.isfinite(ratio)]), 99.5), 1.0, 20.0)
        colours = axes[2].imshow(
            np.clip(ratio, -1e3, 1e3), "RdBu_r", vmin=-largest, vmax=largest, extent=extent, interpolation="nearest"
        )
        axes[2].set_title("with / without")
        figure.colorbar(colours, ax=axes[2], label="[dB]", shrink=0.85)
        axes[0].set_ylabel("slant range [m]")
        for axis in axes:
            axis.set(xlabel="azimuth [m]", xlim=(-35.0, 35.0), ylim=(28.0, -30.0))
        figure.savefig(out / f"effect_{name}.png", dpi=72, pil_kwargs={"optimize": True})
        click.echo(f"{name}: {get(name).summary}")


# ---- objects ----

PICTURED = {
    "box": {"size_m": (6.0, 3.0, 3.0)},
    "cylinder": {"size_m": (4.0, 4.0, 5.0)},
    "sphere": {"size_m": (5.0, 5.0, 5.0)},
    "plate": {"size_m": (0.0, 5.0, 4.0)},
    "dihedral": {"size_m": (4.0, 5.0, 4.0)},
    "trihedral": {"size_m": (5.0, 5.0, 4.0)},
    "car": {"size_m": (4.6, 1.8, 1.5), "side_curvature": 0.1},
    "truck": {"size_m": (8.0, 2.5, 3.4)},
}


@main.command()
@out_option
def objects(out: Path) -> None:
    """Each primitive as triangles, and its image from the south-west over the stated place."""
    figure = Figure(figsize=(11.0, 11.0), layout="constrained")
    for k, (name, more) in enumerate(PICTURED.items()):
        # a floor in the ground's own plane has no front
        place = (0.0, 0.0, 0.02 if name in ("dihedral", "trihedral") else 0.0)
        table = {"primitive": name, "material": "body", "position_m": place, **more}
        scene = with_one(plain([(20.0, 50.0)], 96, 0.2), table)
        assert scene.assembly is not None
        mesh = scene.assembly.placed(scene.objects[0])
        solid: Any = figure.add_subplot(4, 4, 2 * k + 1, projection="3d")
        solid.plot_trisurf(
            *mesh.vertices.T, triangles=mesh.faces, color="tab:blue", edgecolor="k", linewidth=0.2, shade=True
        )
        solid.set_aspect("equal")
        solid.view_init(25, 60)
        solid.set_axis_off()
        solid.set_title(name)
        image = figure.add_subplot(4, 4, 2 * k + 2)
        image.set_facecolor("black")
        shown = decibels(exact_images(scene, CPU)["v0"]["HH"])
        image.imshow(shown, cmap="gray", vmin=-25, vmax=3, extent=(-9.6, 9.6, 9.6, -9.6))
        image.set_title("azimuth [m], range [m]", fontsize=7)
        image.tick_params(labelsize=6)
    figure.savefig(out / "objects.png", dpi=90)


# ---- the paper ----

# Each inside the domain of its model (docs/physics.md).
BRAGG_SURFACE = {"eps_r": 6.885, "rms_height_m": 0.0005, "correlation_length_m": 0.010}
FACET_SURFACE = {"eps_r": 6.885, "rms_height_m": 0.020, "correlation_length_m": 0.200}
# The paper's plane before learning: outside both domains; no surface lies inside both.
MIXED_SURFACE = {"eps_r": 25.0, "rms_height_m": 0.005, "correlation_length_m": 0.010}
ANGLES_DEG = np.linspace(0.0, 80.0, 321)


def label(name: str, value: float) -> str:
    if name == "eps_r":
        return rf"$\varepsilon_r$ = {value:g}"
    return f"${'h' if name == 'rms_height_m' else 'l'}$ = {value * 1e3:g} mm"


def curve(axis: Any, channel: str, tau: float, surface: dict[str, float], **line: Any) -> None:
    material = warpsar.Material(**surface, specular_fraction=tau)
    axis.plot(ANGLES_DEG, sigma0_db(material, channel, 9.6e9, ANGLES_DEG), **line)


def finish(axis: Any, title: str, bottom_db: float, top_db: float) -> None:
    axis.set_title(title, fontsize=9)
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)
    axis.set(xlim=(0.0, 80.0), ylim=(bottom_db, top_db), xlabel="incidence angle [deg]", ylabel=r"$\sigma^0$ [dB]")


@main.command()
@out_option
def paper(out: Path) -> None:
    """sigma0 against incidence at 9.6 GHz: one number of a surface varied (3), the two models of one mixed (4)."""
    figure, axes = new(10.5, 6.4, nrows=2, ncols=3)
    families = (
        (FACET_SURFACE, 1.0, (0.010, 0.020, 0.040), (0.100, 0.200, 0.400), (-50.0, 20.0)),
        (BRAGG_SURFACE, 0.0, (0.00025, 0.0005, 0.001), (0.004, 0.010, 0.014), (-70.0, 0.0)),
    )
    for line, (surface, tau, heights, lengths, limits) in zip(axes, families, strict=True):
        varied = {
            "rms_height_m": heights, "correlation_length_m": lengths, "eps_r": (3.0, 6.885, 25.0, 75.0)
        }  # fmt: skip
        for axis, (name, values) in zip(line, varied.items(), strict=True):
            for i, value in enumerate(values):
                curve(axis, "HH", tau, surface | {name: value}, color=f"C{i}", label=label(name, value))
                if tau < 1.0:
                    curve(axis, "VV", tau, surface | {name: value}, color=f"C{i}", linestyle="--")
            fixed = ", ".join(label(n, v) for n, v in surface.items() if n != name)
            model = "small perturbation, HH solid, VV dashed" if tau < 1.0 else "geometric optics, HH = VV"
            finish(axis, f"{model}\n{fixed}", *limits)
    figure.savefig(out / "figure3.png", dpi=90)
    figure, axes = new(9.0, 4.0, ncols=2)
    fixed = ", ".join(label(n, v) for n, v in MIXED_SURFACE.items())
    for axis, channel in zip(axes, ("HH", "VV"), strict=True):
        for i, tau in enumerate((0.0, 0.25, 0.5, 0.75, 1.0)):
            colour = colormaps["viridis"](0.22 * i)
            curve(axis, channel, tau, MIXED_SURFACE, color=colour, label=rf"$\tau$ = {tau:g}")
        finish(axis, f"{channel}; {fixed}", -40.0, 10.0)
    figure.savefig(out / "figure4.png", dpi=90)


# ---- the first steps ----

LIMITS_DB = (-35.0, 0.0)


def panel(figure: Figure, axis: Any, centres: tuple[Any, Any], values: np.ndarray, title: str, residual: bool) -> None:
    """One image of a view, in metres; `centres` of its rows and columns."""
    r, a = centres
    low, high, colours = (-10.0, 10.0, "RdBu_r") if residual else (*LIMITS_DB, "gray")
    drawn = axis.imshow(values, colours, vmin=low, vmax=high, extent=(a[0], a[-1], r[-1], r[0]))
    axis.set_title(title, fontsize=9)
    axis.set_xlabel("azimuth [m]", fontsize=8)
    axis.tick_params(labelsize=7)
    bar = figure.colorbar(drawn, ax=axis, shrink=0.8, extend="both")
    bar.set_label("measured / modelled [dB]" if residual else "beta0 [dB]", fontsize=8)
    bar.ax.tick_params(labelsize=7)


def step(path: Path, scene: Path, words: str, measured: bool) -> None:
    """The test view `west`: the measured image where asked for, and the residual of a scene."""
    (image,) = [one for one in warpsar.evaluate(warpsar.Scene.load(scene)).images if one.view.name == "west"]
    figure, axes = new(4.2 * (1 + measured), 3.4, ncols=1 + measured, squeeze=False)
    centres, seen = (image.range_m, image.azimuth_m), np.maximum(image.measured, 1e-30)
    if measured:
        panel(figure, axes[0, 0], centres, decibels(seen), "the measured image of the view west", False)
    panel(figure, axes[0, -1], centres, decibels(seen / np.maximum(image.simulated, 1e-12)), words, True)
    axes[0, 0].set_ylabel("slant range [m], radar above", fontsize=8)
    as_webp(figure, path)


def example(path: Path) -> None:
    """The example's three views [dB], of 4 looks."""
    scene = warpsar.Scene.load(EXAMPLE)
    views = warpsar.simulate(scene)
    figure, axes = new(10.0, 3.9, ncols=len(views), sharey=True)
    for axis, view, declared in zip(axes, views, scene.views, strict=True):
        speckled = view.beta0["HH"] * np.random.default_rng(0).gamma(4.0, 0.25, view.beta0["HH"].shape)
        extent = (*_ends(view.azimuth_m), *_ends(view.range_m)[::-1])
        shown = np.maximum(decibels(speckled), -40.0)
        drawn = axis.imshow(shown, "gray", vmin=LIMITS_DB[0], vmax=LIMITS_DB[1], extent=extent)
        axis.set_title(f"{view.name}: azimuth {declared.azimuth_deg:g}°, incidence {declared.incidence_deg:g}°", size=9)
        axis.set_xlabel("azimuth [m]")
    axes[0].set_ylabel("slant range [m]")
    figure.colorbar(drawn, ax=axes, label="beta0, HH, 4 looks [dB]", shrink=0.8)
    save(figure, path)


def _ends(centres: np.ndarray) -> tuple[float, float]:
    half = (centres[1] - centres[0]) / 2.0
    return float(centres[0] - half), float(centres[-1] + half)


def loop(pictures: Path, path: Path) -> None:
    """README's picture: the measured image and its residual, the effect that is named, and what is left beside it."""
    before, after = (Image.open(pictures / name).convert("RGB") for name in ("measured.webp", "diagnosed.webp"))
    heading, third = 34, before.width // 2
    joined = Image.new("RGB", (before.width + after.width, before.height + heading), "white")
    joined.paste(before, (0, heading))
    joined.paste(after, (before.width, heading))
    words = ("1  measured", "2  residual: shadows are too bright", "3  noise_floor added: speckle is left")
    for index, each in enumerate(words):
        ImageDraw.Draw(joined).text((index * third + 14, 9), each, "black", font_size=17)
    joined.save(path, quality=65, method=6)


@main.command()
@out_option
@click.argument("made", metavar="OUT", type=FOLDER)
def getting_started(out: Path, made: Path) -> None:
    """The example scene, and what the page's commands left in OUT; README's picture joins these."""
    pictures = out / "getting-started"
    for name, words in (
        ("measured", "before any fit"),
        ("learned", "measured over learned surfaces"),
        ("diagnosed", "measured over the diagnosed scene"),
    ):
        step(pictures / f"{name}.webp", made / name / "scene.toml", words, name == "measured")
    example(out / "example.png")
    loop(pictures, out / "loop.webp")


if __name__ == "__main__":
    main()
