"""The text beside the pictures: what is shown, scales, colours, timelines."""

from __future__ import annotations

from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.viewer.scales import CLOSE_UP_SHARE, DrawingScales


class Explanation:
    """Explains the pictures of one run."""

    def __init__(self, parameters: Parameters, scales: DrawingScales) -> None:
        self._parameters = parameters
        self._scales = scales

    def text(self) -> str:
        """Markdown."""
        gears, scales = self._parameters.gears, self._scales
        ratio = f"{gears.driving.teeth} and {gears.driven.teeth} teeth, module {gears.module * 1e3:g} mm"
        force = 1.0 / scales.force
        return f"""# Two gears in mesh

The **driving** gear (left) turns counter-clockwise and pushes the **driven** gear (right): {ratio},
backlash {gears.backlash * 1e6:g} µm, model `{self._parameters.model}`. When the load is small or the speed
high, the teeth **lose contact**, fly through the backlash and strike.

**Colour of the flanks in mesh:** blue, drive flanks in contact; yellow, contact lost; orange, back flanks in
contact.

**Timelines** (menu at the bottom left): `slow_motion` plays the moments in which contact is lost, sample by
sample; the line above the gears has the time in the run. `sim_time` is the whole run; there the gears are
seen as under a strobe light: each picture is a sample of the run, chosen so that the teeth seem to creep.

**Scales.** Gears in mm. Backlash, DTE and displacements of gears are **{scales.gap:g} times** as large: drawn
flanks touch when those of the model do. Displacements in the hubs, inside the circle of the bearing
clearance: **{scales.hub:g} times**. Arrows: **1 mm is {force:g} N**, at most
{scales.longest_arrow * force:.0f} N; purple mesh force on each gear (in the close-up 1 mm is
{force / CLOSE_UP_SHARE:g} N), orange bearing contact, green oil film. Thin lines: line of action, base
circles.

**Curves** on `sim_time` have the least and the greatest value of each few ms: no peak is lost.
"""
