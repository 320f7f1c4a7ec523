"""Paths of what is drawn, for drawers and layouts alike. Names are those of the channels."""

from __future__ import annotations

from typing import Final

RUN_TIMELINE: Final = "sim_time"
SLOW_TIMELINE: Final = "slow_motion"

ABOUT_VIEW: Final = "about/view"
ABOUT_RUN: Final = "about/run"
EVENTS: Final = "event"
SCENE: Final = "scene"
MOMENTS: Final = "moments"
ORBIT: Final = "orbit"
PHASE_PORTRAIT: Final = "phase_portrait"
ORDERS: Final = "dte_orders"
WAVEFORM: Final = "waveform"
COMMAND: Final = "command"
IMPACT: Final = "impact"
ENERGY: Final = "energy"
REAL_TIME_FACTOR: Final = "pacing/real_time_factor"
MESHING: Final = "meshing"


def channel_entity(channel: str) -> str:
    """Entity of the curve of a channel, or of a quantity made of channels."""
    return f"{WAVEFORM}/{channel}"


def orbit_entity(gear: str) -> str:
    """Entity of the orbit of one gear's journal."""
    return f"{ORBIT}/{gear}"
