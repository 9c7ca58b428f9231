"""Parts of a report that stands alone: one HTML file with its pictures inside."""

from __future__ import annotations

import base64
import platform
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from warpsar.io.grey_scale import WITHOUT_POWER, GreyScale
from warpsar.io.images import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ASSETS = Path(__file__).parent / "assets"


def page(title: str, summary: str, *sections: str) -> str:
    """The whole document; `title` and `summary` are plain text. The script that enlarges pictures is inside."""
    style, panzoom, script = (
        (ASSETS / name).read_text("utf-8") for name in ("report.css", "panzoom.min.js", "report.js")
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        f'<h1>{escape(title)}</h1>\n<p class="quiet">{escape(summary)}</p>\n'
        + "\n".join(sections)
        + f"\n<script>{panzoom}</script>\n<script>{script}</script>\n</body>\n</html>\n"
    )


def write(path: Path, document: str) -> None:
    """Write the document, atomically, UTF-8."""
    with replacing(path) as temporary:
        temporary.write_text(document, encoding="utf-8")


def section(title: str, *blocks: str) -> str:
    return f"<section>\n<h2>{escape(title)}</h2>\n" + "\n".join(blocks) + "\n</section>"


def heading(text: str) -> str:
    return f"<h3>{escape(text)}</h3>"


def paragraph(text: str, *, quiet: bool = False) -> str:
    return f'<p class="quiet">{_prose(text)}</p>' if quiet else f"<p>{_prose(text)}</p>"


def bullets(items: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{_prose(item)}</li>" for item in items) + "</ul>"


def _prose(text: str) -> str:
    """Words that the console says too, which keeps to ASCII."""
    return escape(text.replace("+- ", "±\u00a0"))


def link(address: str, text: str) -> str:
    """To a file beside the document."""
    return f'<p><a href="{escape(address)}">{escape(text)}</a></p>'


def command(line: str) -> str:
    """A line to type in a shell."""
    return f"<pre>{escape(line)}</pre>"


def table(
    columns: Sequence[str], rows: Sequence[Sequence[object]], caption: str = "", words: Sequence[int] = ()
) -> str:
    """Cells are plain text, the first column left, the others right; scrolls by itself where it is too wide.

    Columns of `words`, by number, are left, and their lines break.
    """
    kinds = [' class="words"' if k in words else "" for k in range(len(columns))]
    head = "".join(f'<th scope="col"{kind}>{escape(c)}</th>' for c, kind in zip(columns, kinds, strict=True))
    body = "".join(
        "<tr>"
        + "".join(f"<td{kind}>{escape(str(cell))}</td>" for cell, kind in zip(row, kinds, strict=False))
        + "</tr>"
        for row in rows
    )
    text = f"<caption><span>{escape(caption)}</span></caption>" if caption else ""  # the span is as wide as the page
    return f'<div class="wide"><table>{text}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


@dataclass(frozen=True)
class Bar:
    """One of `bars`: `length` is 0 to 1, `number` stands at its end, a `marked` one has a colour of its own."""

    name: str
    length: float
    number: str
    marked: bool = False


def bars(all_bars: Sequence[Bar], line: float, caption: str) -> str:
    """Bars one below the other, and a line across them at `line`, 0 to 1."""
    rows = "".join(
        f"<dt>{escape(one.name)}</dt>"
        f'<dd><i{" class=marked" if one.marked else ""} style="width: {100.0 * one.length:.4g}%"></i>'
        f"{escape(one.number)}</dd>"
        for one in all_bars
    )
    return (
        f'<figure class="bars"><dl style="--line: {line:.4g}">{rows}</dl>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def facts(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and values, one below the other."""
    return "<dl>" + "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in pairs) + "</dl>"


def row(*cells: str, across: int = 4, least_px: int = 158) -> str:
    """Cells side by side: at most `across`, and fewer where each would be narrower than `least_px`.

    Two of 158 pixels fit side by side on a phone.
    """
    return f'<div class="row" style="--across: {across}; --least: {least_px}px">' + "".join(cells) + "</div>"


def cell(*blocks: str) -> str:
    """Words in a row of pictures; on a phone they take the whole width."""
    return '<div class="cell">' + "".join(blocks) + "</div>"


def picture(png: bytes, caption: str) -> str:
    """A picture without axes; for an image of measurements there is `html_image.image`."""
    return _figure(data_uri(png, "image/png"), caption, "picture")


def drawing(figure: Figure, caption: str, *, show: bool = True) -> str:
    """A matplotlib figure, as SVG; the caption is read out in its place, and shown unless `show` is false."""
    import matplotlib

    stream = BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "warpsar"}):  # the same figure is the same bytes
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return _figure(data_uri(stream.getvalue(), "image/svg+xml"), caption, "drawing", show=show)


def _figure(uri: str, caption: str, kind: str, *, show: bool = True) -> str:
    text = f"<figcaption>{escape(caption)}</figcaption>" if show else ""
    return f'<figure><img class="{kind}" src="{uri}" alt="{escape(caption, quote=True)}">{text}</figure>'


def data_uri(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def scale(colours: str, ticks: Sequence[str], label: str, at: ArrayLike | None = None) -> str:
    """The key of a colour scale: `colours` names a matplotlib map, `ticks` stand evenly along the bar. `at`: which part
    of the map, 0 to 1, lies at even steps along it; all of it, evenly, where nothing is said."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    shares = np.linspace(0.0, 1.0, 17) if at is None else np.asarray(at, float)
    stops = ", ".join(to_hex(colour) for colour in colormaps[colours](shares))
    marks = "".join(f"<span>{escape(tick)}</span>" for tick in ticks)
    return (
        f'<span class="scale">{escape(label)}<i style="background: linear-gradient(to right, {stops})"></i>'
        f"<b>{marks}</b></span>"
    )


def beta0_scale(greys: GreyScale, *, beyond_mesh: bool = False) -> str:
    """The key of images of beta0, a bar that is linear in dB. `beyond_mesh`: whether they show where the mesh ends."""
    marks = [f"{at:.0f}".replace("-", "\u2212") for at in np.linspace(greys.levels_db[0], greys.levels_db[-1], 5)]
    key = scale("gray", [*marks[:-1], f"{marks[-1]} dB"], "beta0", greys.along(65))
    if not beyond_mesh:
        return key
    blue = ", ".join(f"{255.0 * part:.0f}" for part in WITHOUT_POWER)
    return f'{key}<span class="patch"><i style="background: rgb({blue})"></i>no mesh there</span>'


def colour(values: np.ndarray, colours: str, low: float, high: float) -> np.ndarray:
    """RGB, 0 to 1, shape (*values.shape, 3), of the matplotlib map `colours` from `low` to `high`; NaN is mid-grey."""
    from matplotlib import colormaps

    span = high - low if high > low else 1.0
    rgb = colormaps[colours](np.clip((np.nan_to_num(values) - low) / span, 0.0, 1.0))[..., :3]
    return np.where(np.isnan(values)[..., None], 0.75, rgb)


def png(rgb: np.ndarray) -> bytes:
    """A PNG file of a picture, RGB or RGBA, shape (rows, cols, 3 or 4), float from 0 to 1 or uint8."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    stream, made_by = BytesIO(), PngInfo()
    made_by.add_text("Software", "warpsar")
    whole = rgb if rgb.dtype == np.uint8 else np.round(255.0 * rgb).astype(np.uint8)
    Image.fromarray(whole).save(stream, "png", compress_level=6, pnginfo=made_by)
    return stream.getvalue()


def reproduce(content: dict[str, Any], words: Sequence[str], beside: str) -> str:
    """The closing section: the command and what it ran with. `content` is its JSON; `beside` names the other files."""
    packages = ("warp-lang", "numpy", "scipy", "trimesh", "OpenImageIO", "matplotlib")
    made_with = ", ".join([f"Python {platform.python_version()}", *(f"{name} {version(name)}" for name in packages)])
    return section(
        "To make this again",
        command(shlex.join(words)),
        facts(
            [
                ("warpsar", content["version"]),
                ("with", made_with),
                ("device", content["device"]),
                *([] if content["seed"] is None else [("seed", str(content["seed"]))]),
                ("time", f"{content['wall_time_s']:.1f} s"),
                ("input", f"{content['input']['scene']}, SHA-256 {content['input']['sha256'][:16]}…"),
            ]
        ),
        paragraph(beside, quiet=True),
    )
