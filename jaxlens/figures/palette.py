"""Colours, and the width of a page: without matplotlib, so that they can stand in constants."""

# Okabe and Ito's palette, the strongest contrasts first; its yellow is too light for lines.
BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#E69F00",
    "#CC79A7",
    "#56B4E9",
    "#000000",
)
PALETTE = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK)
MUTED = "#5A5A5A"
FAINT = "#D9D9D9"
WIDTH = 7.0
"""The width of a figure in inches: with these fonts legible at full width and in half a page."""
