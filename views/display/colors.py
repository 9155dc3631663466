"""Colors of zones, end uses and comfort, equal in all pictures of a building.

Colors are (red, green, blue), each 0 to 255. The colors of lines have a contrast of at least 3 to a white and to a
near-black ground, as WCAG 2.2 asks of graphics, and those of one plot are told apart by readers with deuteranopia, too:
they were searched for, and tests compute the distances. The colors of further zones are computed in OKLCH (B. Ottosson,
A perceptual color space for image processing, 2020), where equal distances look equally far apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import cos, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

RGB = tuple[int, int, int]

UNKNOWN: RGB = (128, 128, 128)
"""Color of what has no value: a zone without a temperature, an unknown end use."""

OUTDOOR: RGB = (95, 140, 190)
"""Color of the outdoor temperature."""

FACILITY = "facility"
"""Label of all uses of a fuel in the building."""

_FACILITY_FUEL: RGB = (100, 50, 250)

COMFORT_RANGE_K = 4.0
"""Deviation from the comfort band at which the comfort scale ends."""

WITHIN: RGB = (226, 229, 224)
"""Color of a zone within its comfort band."""

_STOPS: tuple[tuple[float, RGB], ...] = (
    (-COMFORT_RANGE_K, (22, 70, 158)),
    (-2.0, (62, 128, 214)),
    (-0.05, (176, 206, 238)),
    (0.0, WITHIN),
    (0.05, (250, 214, 160)),
    (2.0, (240, 138, 36)),
    (COMFORT_RANGE_K, (168, 42, 8)),
)

_GOLDEN_ANGLE_DEG = 137.50776
_FIRST_HUE_DEG = 250.0
_LIGHTNESS = (0.645, 0.549, 0.612, 0.518, 0.58)
_CHROMA = 0.17

_ZONES: tuple[RGB, ...] = (
    (40, 120, 220), (235, 110, 0), (0, 115, 40), (170, 50, 130), (180, 125, 215), (145, 150, 130), (175, 65, 0),
    (105, 85, 155), (40, 170, 70), (105, 95, 85), (225, 100, 170), (185, 140, 50), (110, 145, 235), (80, 150, 175),
    (175, 105, 90), (0, 100, 175), (120, 125, 125), (100, 120, 35), (135, 105, 195), (15, 105, 130), (195, 95, 0),
    (240, 100, 115), (110, 120, 175), (155, 70, 75), (140, 130, 255), (55, 140, 100), (125, 85, 105), (150, 125, 40),
    (70, 85, 200), (195, 80, 155),
)  # fmt: skip
"""Each is as far as possible from those before it, for readers with and without deuteranopia."""

_END_USES: dict[str, tuple[RGB, RGB]] = {
    "heating": ((225, 100, 85), (185, 80, 65)),
    "cooling": ((30, 135, 245), (45, 95, 210)),
    "fans": ((35, 155, 160), (5, 120, 135)),
    "pumps": ((145, 115, 235), (105, 80, 195)),
    "heat rejection": ((5, 145, 210), (25, 105, 140)),
    "humidification": ((100, 150, 110), (20, 110, 90)),
    "heat recovery": ((185, 105, 205), (140, 60, 180)),
    "interior lights": ((170, 135, 0), (155, 100, 0)),
    "exterior lights": ((150, 150, 45), (85, 105, 45)),
    "interior equipment": ((135, 130, 140), (105, 105, 120)),
    "exterior equipment": ((165, 140, 140), (125, 110, 100)),
    "water systems": ((65, 160, 90), (25, 130, 75)),
    "refrigeration": ((85, 140, 175), (65, 120, 175)),
    "cogeneration": ((70, 145, 35), (20, 120, 15)),
}
"""Color of each end use for electricity and for other fuels."""


@cache
def zone_color(place: int) -> RGB:
    """Return the color of the zone at this place in its building, from 0.

    Any two of the first 24 differ by at least 10 in CIELAB for readers with deuteranopia. From the 31st on, neighboring
    places differ in hue by the golden angle and in lightness.
    """
    if place < len(_ZONES):
        return _ZONES[place]
    hue_deg = _FIRST_HUE_DEG + place * _GOLDEN_ANGLE_DEG
    return _oklch(_LIGHTNESS[place % len(_LIGHTNESS)], _CHROMA, hue_deg)


def end_use_color(end_use: str, fuel: str = "electricity") -> RGB:
    """Return the color of an end use, such as `interior lights`; other fuels than electricity are darker.

    Any two differ by at least 10 in CIELAB for readers with deuteranopia (G. Machado, M. Oliveira, L. Fernandes, A
    physiologically-based model for simulation of color vision deficiency, 2009).
    """
    if end_use in (FACILITY, "HVAC"):
        return _FACILITY_FUEL
    if end_use not in _END_USES:
        return UNKNOWN
    return _END_USES[end_use][fuel != "electricity"]


def comfort_colors(deviation_k: ArrayLike) -> NDArray[np.uint8]:
    """Return colors of deviations from the comfort band, shape (..., 3).

    The scale is diverging and safe for color-blind readers: pale within the band (0), blue below it (to -4 K), orange
    to red above it (to 4 K), gray where the deviation is unknown (NaN). The first hundredth of a kelvin outside is
    visibly tinted.
    """
    deviation = np.asarray(deviation_k, np.float64)
    ends = np.array([stop for stop, _ in _STOPS])
    table = np.array([color for _, color in _STOPS], np.float64)
    known = np.clip(np.nan_to_num(deviation), -COMFORT_RANGE_K, COMFORT_RANGE_K)
    colors = np.stack([np.interp(known, ends, table[:, channel]) for channel in range(3)], axis=-1)
    colors[np.isnan(deviation)] = UNKNOWN
    return np.rint(colors).astype(np.uint8)


def comfort_color(deviation_k: float) -> RGB:
    """Return the color of one deviation; see `comfort_colors`."""
    red, green, blue = comfort_colors(deviation_k).tolist()
    return red, green, blue


def hex_color(color: Sequence[int]) -> str:
    """Return a color as in HTML: `#1f77b4`."""
    return "#" + "".join(f"{channel:02x}" for channel in color)


def contrast(first: Sequence[int], second: Sequence[int]) -> float:
    """Return the contrast ratio of two colors by WCAG 2.2, 1 to 21."""
    low, high = sorted((_luminance(first), _luminance(second)))
    return (high + 0.05) / (low + 0.05)


def _luminance(color: Sequence[int]) -> float:
    channels = (channel / 255.0 for channel in color)
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _oklch(lightness: float, chroma: float, hue_deg: float) -> RGB:
    """Convert to sRGB; the chroma is lowered until the color exists."""
    hue = radians(hue_deg)
    while True:
        linear = _linear_rgb(lightness, chroma * cos(hue), chroma * sin(hue))
        if chroma < 1e-3 or all(-1e-4 <= channel <= 1.0001 for channel in linear):
            break
        chroma *= 0.97
    red, green, blue = (round(255.0 * _gamma(min(max(channel, 0.0), 1.0))) for channel in linear)
    return red, green, blue


def _linear_rgb(lightness: float, a: float, b: float) -> tuple[float, float, float]:
    """Convert OKLab to linear sRGB, with Ottosson's matrices."""
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    medium = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    return (
        4.0767416621 * long - 3.3077115913 * medium + 0.2309699292 * short,
        -1.2684380046 * long + 2.6097574011 * medium - 0.3413193965 * short,
        -0.0041960863 * long - 0.7034186147 * medium + 1.7076147010 * short,
    )


def _gamma(channel: float) -> float:
    return float(12.92 * channel if channel <= 0.0031308 else 1.055 * channel ** (1.0 / 2.4) - 0.055)
