"""The size of recordings."""

from pathlib import Path

import numpy as np
import rerun as rr
from support import builders
from support.monitor import office, samples, two_storeys

from zenostat.metrics.comfort import default_comfort
from zenostat.views.live.node_stream import NodeStream
from zenostat.views.live.stream import ROWS

YEAR, SHARE = 35040, 10
LIMIT_BYTES = 27e6


def test_rerun_recording__year_of_sixty_points_stays_below_27_megabytes(scratch: Path) -> None:
    """By a tenth of a year: zones whose temperature swings by 4 K each day, and noise, at night none."""
    path, manifest = scratch / "run.rrd", office(steps=YEAR, end="2018-07-01T00:00:00")
    units = ("m3/s", "kg/s", "W/m2", "Pa", "percent")
    extra = [builders.sensor(f"extra_{n}", "", unit=units[n % 5]) for n in range(60 - len(manifest.points))]
    manifest = manifest.model_copy(update={"sensors": (*manifest.sensors, *extra)})
    assert len(manifest.points) == 60
    values = 22.0 + np.random.default_rng(0).normal(0, 3, (YEAR // SHARE, 60))
    values[np.arange(len(values)) % 96 < 40] = 22.0
    values[:, 1:3] = 24.0 + 4.0 * np.sin(2 * np.pi * np.arange(len(values)) / 96)[:, None]
    recording = rr.RecordingStream("zenostat")
    recording.set_sinks(rr.FileSink(str(path)))
    node = NodeStream(recording, manifest, two_storeys(), default_comfort, None)
    for sample in samples(manifest, values):
        node.add_sample(sample)
        if len(node.samples) == ROWS:
            node.flush()
    node.flush()
    recording.flush()
    recording.disconnect()
    assert path.stat().st_size * SHARE < LIMIT_BYTES
