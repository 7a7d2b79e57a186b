"""Colours of the overlays, blue-green-red.

Tracks and health have those of M. Okabe and K. Ito (Color Universal Design, 2008), which people
with a colour vision deficiency can tell apart. The original's two pictures keep its own.
"""

Color = tuple[int, int, int]

# the original's pictures
BLUE: Color = (255, 100, 0)
RED: Color = (0, 0, 255)
DARK_RED: Color = (30, 30, 170)
GREEN: Color = (60, 255, 60)
PINK: Color = (203, 105, 255)

WHITE: Color = (255, 255, 255)
GREY: Color = (185, 185, 185)
BLACK: Color = (0, 0, 0)
DARK: Color = (70, 70, 70)

ORANGE: Color = (0, 159, 230)
SKY_BLUE: Color = (233, 180, 86)
BLUISH_GREEN: Color = (115, 158, 0)
YELLOW: Color = (66, 228, 240)
VERMILLION: Color = (0, 94, 213)
REDDISH_PURPLE: Color = (167, 121, 204)

OF_TRACKS: tuple[Color, ...] = (
    ORANGE, SKY_BLUE, YELLOW, REDDISH_PURPLE, BLUISH_GREEN, VERMILLION,
)  # fmt: skip


def color_of(track_id: int) -> Color:
    """The colour of a track, the same as long as it lives."""
    return OF_TRACKS[track_id % len(OF_TRACKS)]


def dimmed(color: Color) -> Color:
    """The same colour, half as bright."""
    blue, green, red = (c // 2 for c in color)
    return blue, green, red
