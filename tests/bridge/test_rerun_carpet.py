"""The carpet: the value farthest from the band in each column, and its picture."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.display.colors import comfort_color
from bridge.rerun.carpet import MAX_COLUMNS, Carpet, picture, png, row_height


def test_a_column_has_the_deviation_that_is_farthest_from_the_band() -> None:
    carpet = Carpet(2, 35040)
    assert carpet.deviations.shape[1] <= MAX_COLUMNS
    steps = np.arange(26)
    assert carpet.column_of(25) == 0
    deviations = np.zeros((26, 2))
    deviations[3, 0], deviations[7, 0], deviations[9, 1] = 1.5, -2.5, 0.5
    carpet.add(steps[:8], deviations[:8])
    carpet.add(steps[8:], deviations[8:])
    assert carpet.deviations[:, 0].tolist() == [-2.5, 0.5]
    assert np.isnan(carpet.deviations[:, 1:]).all()


@given(st.integers(1, 100_000))
def test_each_step_has_a_column(steps: int) -> None:
    carpet = Carpet(1, steps)
    columns = [carpet.column_of(step) for step in (0, steps // 2, steps)]
    assert 0 <= columns[0] <= columns[1] <= columns[2] < carpet.deviations.shape[1] <= MAX_COLUMNS


def test_unknown_is_replaced_by_what_comes() -> None:
    carpet = Carpet(1, 10)
    carpet.add(np.array([0]), np.array([[np.nan]]))
    carpet.add(np.array([0]), np.array([[0.0]]))
    assert carpet.deviations[0, 0] == 0.0


def test_pixels_have_the_colors_of_the_comfort_scale() -> None:
    pixels = picture(np.array([[3.0, np.nan], [-1.0, 0.0]]), 10)
    assert pixels.shape == (20, 2, 3)
    assert tuple(pixels[4, 0]) == comfort_color(3.0)
    assert tuple(pixels[14, 0]) == comfort_color(-1.0)
    assert tuple(pixels[4, 1]) not in {comfort_color(0.0), comfort_color(3.0)}


@pytest.mark.parametrize("zones", [1, 5, 55, 118, 900])
def test_rows_can_be_seen(zones: int) -> None:
    assert row_height(zones, MAX_COLUMNS) >= 3


def test_png_is_read_back() -> None:
    """By undoing the filter `Up`: each byte is the sum of its difference and the byte above."""
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, 3), np.uint8)
    data = png(pixels)
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, at = {}, 8
    while at < len(data):
        (size,), kind = struct.unpack(">I", data[at : at + 4]), data[at + 4 : at + 8]
        chunks[kind] = data[at + 8 : at + 8 + size]
        assert struct.unpack(">I", data[at + 8 + size : at + 12 + size]) == (zlib.crc32(kind + chunks[kind]),)
        at += 12 + size
    assert struct.unpack(">IIBB", chunks[b"IHDR"][:10]) == (5, 7, 8, 2)
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(7, 16)
    assert (rows[:, 0] == 2).all()
    np.testing.assert_array_equal(np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8).reshape(7, 5, 3), pixels)
