"""Colours that colour-blind people can tell apart (M. Okabe, K. Ito, "Color Universal Design", 2008)."""

from __future__ import annotations

BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
GREY = "#8C8C8C"
DIM = "#4A4A4A"
YELLOW = "#F0E442"
