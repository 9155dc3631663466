"""The fixed channels of a recording; further ones have the keys of controllers, actuators and requests."""

from __future__ import annotations

from zenostat.topics import keys, recording
from zenostat.topics.messages import Event, Manifest, Message, Sample
from zenostat.topics.recording import (
    RecordedAudit,
    RecordedEpisode,
    RecordedMessage,
    RecordedOrder,
    RecordedSender,
    RecordedSnapshot,
    RecordedState,
    RecordedWeather,
)

SAMPLES, EVENTS, MANIFESTS, ORDERS, EPISODES, SNAPSHOTS, OTHERS, WEATHER, SENDERS, AUDIT, STATES = range(11)
"""Numbers of the channels."""

CHANNELS: tuple[tuple[str, type[Message]], ...] = (
    (keys.SAMPLE.key, Sample),
    (keys.EVENT.key, Event),
    (keys.MANIFEST.key, Manifest),
    (recording.ORDERS, RecordedOrder),
    (recording.EPISODES, RecordedEpisode),
    (recording.SNAPSHOTS, RecordedSnapshot),
    (recording.OTHERS, RecordedMessage),
    (recording.WEATHER, RecordedWeather),
    (recording.SENDERS, RecordedSender),
    (recording.AUDIT_CHAIN, RecordedAudit),
    (recording.STATES, RecordedState),
)
"""Topic below the node's root and class of each fixed channel, by its number."""
