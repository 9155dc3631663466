"""Write a node's recording as a Rerun recording: what the live monitor would have saved."""

from __future__ import annotations

from pathlib import Path

import rerun as rr

from zenostat.bridge.recording.reader import RecordingReader
from zenostat.metrics.comfort import default_comfort
from zenostat.topics import codec
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import BadMessage, InvalidRecording
from zenostat.topics.messages import Event, Manifest, Sample
from zenostat.views.live.layout import blueprint
from zenostat.views.live.node_stream import NodeStream
from zenostat.views.live.recording import write_out
from zenostat.views.live.samples import ComfortFactory, RewardFactory
from zenostat.views.live.stream import ROWS

_SCHEMAS = frozenset(("Sample", "Event", "Manifest"))


def write_rrd(
    reader: RecordingReader,
    path: Path,
    *,
    comfort: ComfortFactory = default_comfort,
    reward: RewardFactory | None = None,
) -> int:
    """Write the samples and events of a recording to an .rrd file; return the number of samples.

    Args:
        reader: of the recording.
        path: of the file.
        comfort: as of `zenostat.views.live.stream.RerunStream`.
        reward: as of `zenostat.views.live.stream.RerunStream`.

    Raises:
        InvalidRecording: the recording has no samples, or is damaged.
        ViewerError: the file cannot be written.
    """
    with atomic_file(path) as temporary:
        stream = rr.RecordingStream("zenostat")
        stream.set_sinks(rr.FileSink(str(temporary)))
        try:
            count = _log(reader, stream, comfort, reward)
            write_out(stream, str(path))
        finally:
            stream.disconnect()
        if not count:
            raise InvalidRecording(f"{reader.path} has no samples")
    return count


def _log(
    reader: RecordingReader, stream: rr.RecordingStream, comfort: ComfortFactory, reward: RewardFactory | None
) -> int:
    node, count = NodeStream(stream, reader.manifest, reader.geometry, comfort, reward), 0
    for item in reader.messages(_SCHEMAS):
        try:
            if item.schema == "Sample":
                count += node.add_sample(codec.decode(Sample, item.payload))
            elif item.schema == "Event":
                node.add_event(codec.decode(Event, item.payload))
            else:
                node.set_manifest(codec.decode(Manifest, item.payload))
        except BadMessage as error:
            raise InvalidRecording(f"{reader.path} is damaged: {item.topic}: {error}") from None
        if len(node.samples) >= ROWS:
            node.flush()
    node.flush()
    node.draw()
    if node.view is not None:
        stream.send_blueprint(blueprint([(node.model, node.view)]))
    return count
