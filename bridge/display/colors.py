"""Colors of zones, end uses and comfort, equal in all pictures of a building.

Colors are (red, green, blue), each 0 to 255. They are computed in OKLCH (B. Ottosson, A perceptual color space for
image processing, 2020), where equal distances look equally far apart. The colors of lines have a contrast of at least 3
to a white and to a near-black ground, as WCAG 2.2 asks of graphics.
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

OUTDOOR: RGB = (124, 134, 146)
"""Color of the outdoor temperature."""

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

_END_USES = {
    "heating": (35.0, 0.18), "cooling": (255.0, 0.15), "fans": (200.0, 0.10), "pumps": (300.0, 0.15),
    "heat rejection": (225.0, 0.12), "humidification": (180.0, 0.09), "heat recovery": (330.0, 0.14),
    "interior lights": (90.0, 0.13), "exterior lights": (110.0, 0.13), "interior equipment": (280.0, 0.03),
    "exterior equipment": (60.0, 0.06), "water systems": (160.0, 0.12), "refrigeration": (240.0, 0.06),
    "cogeneration": (140.0, 0.15),
}  # fmt: skip
"""Hue in degrees and chroma of each end use."""


@cache
def zone_color(place: int) -> RGB:
    """Return the color of the zone at this place in its building, from 0.

    Neighboring places differ in hue by the golden angle and in lightness, so that about 30 zones can be told apart.
    """
    hue_deg = _FIRST_HUE_DEG + place * _GOLDEN_ANGLE_DEG
    return _oklch(_LIGHTNESS[place % len(_LIGHTNESS)], _CHROMA, hue_deg)


@cache
def end_use_color(end_use: str, fuel: str = "electricity") -> RGB:
    """Return the color of an end use, such as `interior lights`; other fuels than electricity are darker."""
    if end_use not in _END_USES:
        return UNKNOWN
    hue_deg, chroma = _END_USES[end_use]
    return _oklch(0.63 if fuel == "electricity" else 0.52, chroma, hue_deg)


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
