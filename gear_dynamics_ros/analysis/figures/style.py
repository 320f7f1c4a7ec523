"""How all figures look, and how they are written."""

from __future__ import annotations

import base64
import io
import itertools
import re
from collections.abc import Callable
from typing import Any, BinaryIO, Final, cast

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from gear_dynamics_ros import palette

MICRO: Final = 1e6
KILO: Final = 1e-3

FIGURE_STYLE: Final[dict[str, Any]] = {
    "font.size": 9.5,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#222222",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.7,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.dpi": 140,
    # Points drawn at once: a long path that crosses itself at every point takes memory with their square.
    "agg.path.chunksize": 2000,
    "svg.hashsalt": "gear_dynamics_ros",  # the same figure is the same file
}
GEAR_COLOURS: Final = {"driving": palette.BLUE, "driven": palette.ORANGE}
RASTER_DPI: Final = 150  # of dense parts of a vector file
THINNED_COLUMNS: Final = 1200  # that a long curve keeps its extremes of: more than a printed column shows


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """``draw`` with FIGURE_STYLE in force while it runs."""

    def wrapper(*args: Any, **keywords: Any) -> Figure:
        with mpl.rc_context(cast(Any, FIGURE_STYLE)):  # its stub wants a literal for every key
            return draw(*args, **keywords)

    return wrapper


def write_png(figure: Figure, stream: BinaryIO) -> None:
    """Write ``figure`` to ``stream``, and fix its layout for further files. Raises OSError if that fails."""
    with mpl.rc_context(cast(Any, FIGURE_STYLE)):
        figure.savefig(stream, format="png")
    figure.set_layout_engine("none")  # finding it takes as long as drawing


def write_svg(figure: Figure, stream: BinaryIO) -> None:
    """Write ``figure`` to ``stream``, the same bytes each time. Raises OSError if that fails.

    Paths have hundredths of a point, rasterised parts few colours: less than half the size.
    """
    with mpl.rc_context(cast(Any, FIGURE_STYLE)), io.BytesIO() as drawn:
        figure.savefig(drawn, format="svg", metadata={"Date": None}, dpi=RASTER_DPI)
        text = drawn.getvalue()
    text = re.sub(rb' d="[^"]*"', lambda path: re.sub(rb"(\.\d\d)\d+", rb"\1", path.group()), text)
    stream.write(re.sub(rb"(?<=data:image/png;base64,)[^\"]+", _fewer_colours, text))


def _fewer_colours(encoded: re.Match[bytes]) -> bytes:
    """The PNG file ``encoded`` in base64 with 256 colours, or 128 with transparency."""
    with io.BytesIO(base64.b64decode(encoded.group())) as drawn, io.BytesIO() as small:
        picture = Image.open(drawn).convert("RGBA")
        if picture.getchannel("A").getextrema() == (255, 255):  # a map: its colours are amplitudes
            quantized = picture.convert("RGB").quantize(colors=256, dither=Image.Dither.NONE)
        else:
            quantized = picture.quantize(128, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        quantized.save(small, format="PNG", optimize=True)
        return base64.b64encode(small.getvalue())


def thinned(
    x: NDArray[np.float64], y: NDArray[np.float64], columns: int = THINNED_COLUMNS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The curve ``y`` over ascending ``x``, both (n,), as at most 2 * ``columns`` + 2 points.

    No extreme is lost: of each of ``columns`` groups of neighbours the smallest and the greatest value stay.
    """
    if len(x) <= 2 * columns:
        return x, y
    starts = np.linspace(0, len(x), columns + 1).astype(int)
    groups = list(itertools.pairwise(starts))
    lowest = np.array([begin + y[begin:end].argmin() for begin, end in groups])
    highest = np.array([begin + y[begin:end].argmax() for begin, end in groups])
    kept = np.unique(np.concatenate([[0, len(x) - 1], lowest, highest]))
    return x[kept], y[kept]


def write_small_png(figure: Figure, stream: BinaryIO) -> None:
    """As ``write_png``, in 128 colours: a third of the size, for pictures that documents show."""
    with io.BytesIO() as drawn:
        write_png(figure, drawn)
        stream.write(small_png(drawn.getvalue()))


def small_png(picture: bytes) -> bytes:
    """The PNG file ``picture`` in 128 colours."""
    with io.BytesIO(picture) as drawn, io.BytesIO() as small:
        fewer = Image.open(drawn).convert("RGB").quantize(colors=128, dither=Image.Dither.NONE)
        fewer.save(small, format="PNG", optimize=True)
        return small.getvalue()
