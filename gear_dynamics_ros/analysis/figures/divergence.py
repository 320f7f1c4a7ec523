"""How two recordings differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gear_dynamics_ros import palette
from gear_dynamics_ros.analysis.comparison import ChannelDifference
from gear_dynamics_ros.analysis.figures.style import MICRO, styled
from gear_dynamics_ros.analysis.statistics import Envelope
from gear_dynamics_ros.analysis.summary import QUANTITY_UNITS
from gear_dynamics_ros.chunk import Samples


class Overlay(NamedTuple):
    """One channel of A and B around the time ``marked`` in s."""

    title: str
    channel: str
    a: Samples
    b: NDArray[np.float64]  # shape (n,)
    marked: float


@styled
def divergence_figure(
    envelope: Envelope,
    differences: Mapping[str, ChannelDifference],
    interval: float,
    overlays: Sequence[Overlay],
) -> Figure:
    """How two recordings differ: |A - B| of some channels over time, and A and B in ``overlays``.

    ``envelope`` holds |A - B|, ``differences`` the channels to show, of which at least one value differs;
    ``interval`` is the sample interval in s.
    """
    heights = (1.7 * len(differences) + 0.6, 4.4)
    figure = Figure(figsize=(10.0, sum(heights)), layout="constrained")
    parts = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)
    above, below = parts[:, 0]
    axes = above.subplots(len(differences), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (name, found) in zip(axes, differences.items(), strict=True):
        _draw_growth(axis, envelope, name, found, interval)
    axes[0].set_title("|A - B|, maximum of each time interval")
    axes[-1].set_xlabel("simulated time (s)")
    above.align_ylabels(axes)
    columns = below.subplots(2, len(overlays), sharex="col", squeeze=False, height_ratios=(3, 2)).T
    for (values, apart), overlay in zip(columns, overlays, strict=True):
        _draw_overlay(values, apart, overlay)
    columns[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0)
    below.align_ylabels()
    return figure


def _draw_growth(
    axis: Axes, envelope: Envelope, name: str, found: ChannelDifference, interval: float
) -> None:
    """|A - B| of one channel on a logarithmic axis, which leaves out where it is 0."""
    greatest, times = envelope.bounds(name)[1], envelope.times()
    axis.semilogy(
        times,
        np.where(greatest > 0.0, greatest, np.nan),
        color=palette.BLUE,
        marker=".",
        markersize=2.0,
        linewidth=0.8,
        label="|A - B|",
    )
    if found.rms_a > 0.0:
        axis.axhline(
            found.rms_a,
            color=palette.GREY,
            linewidth=0.9,
            linestyle="--",
            label=f"RMS of A\n{found.rms_a:.3g}",
        )
    if found.first_difference is not None:
        first = found.first_difference * interval
        axis.axvline(
            first, color=palette.ORANGE, linewidth=1.1, linestyle=":", label=f"first differs\n{first:.9g} s"
        )
    axis.set_xlim(*_with_margin(float(times[0]), float(times[-1])))
    axis.set_ylabel(_with_unit(name))
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), handlelength=1.6)


def _with_margin(low: float, high: float) -> tuple[float, float]:
    margin = 0.01 * (high - low) or 1e-6
    return low - margin, high + margin


def _with_unit(name: str) -> str:
    unit = QUANTITY_UNITS[name]
    return f"{name}\n({unit})" if unit else name


def _draw_overlay(values: Axes, apart: Axes, overlay: Overlay) -> None:
    """A and B in one diagram, and A - B below."""
    milliseconds = 1e3 * (overlay.a.time - overlay.marked)
    a, b = overlay.a[overlay.channel], overlay.b
    scale, unit = (
        (MICRO, "µm") if QUANTITY_UNITS[overlay.channel] == "m" else (1.0, QUANTITY_UNITS[overlay.channel])
    )
    name = "DTE" if overlay.channel == "dte" else overlay.channel
    # The thin curve B stays visible on top of the wide curve A where they are equal.
    values.plot(milliseconds, scale * a, color=palette.SKY, linewidth=4.0, label="A")
    values.plot(milliseconds, scale * b, ".-", color=palette.ORANGE, linewidth=0.9, markersize=3.0, label="B")
    values.set_ylabel(f"{name} ({unit})" if unit else name)
    values.set_title(overlay.title)
    apart.plot(milliseconds, scale * (a - b), ".-", color=palette.BLUE, linewidth=0.9, markersize=3.0)
    apart.set_ylabel(f"A - B ({unit})" if unit else "A - B")
    apart.set_xlabel(f"time after {overlay.marked:.9g} s (ms)")
    for axis in (values, apart):
        axis.axvline(0.0, color=palette.ORANGE, linewidth=1.1, linestyle=":")
        axis.margins(x=0.01)
