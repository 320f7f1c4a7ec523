"""Colours that stay apart for colour-blind eyes (Okabe and Ito, 2008)."""

from __future__ import annotations

BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
GREY = "#8C8C8C"
DIM = "#4A4A4A"
YELLOW = "#F0E442"
