"""Retained messages of a gateway on its broker."""

from __future__ import annotations

from collections.abc import Iterable

import aiomqtt

from zenostat.gateways.points import readings
from zenostat.topics.messages import Manifest


def point_topics(manifest: Manifest, root: str) -> list[str]:
    """Return the topic of each sensor, meter and actuator below a root, in the manifest's order."""
    count = len(manifest.sensors)
    return [
        *(f"{root}/{'sensor' if r.index < count else 'meter'}/{r.name}" for r in readings(manifest)),
        *(f"{root}/actuator/{actuator.name}" for actuator in manifest.actuators),
    ]


class RetainedMessages:
    """The retained messages that a gateway has published, so that it publishes changes only."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._topics: set[str] = set()

    def reconnected(self) -> None:
        """Publish all of them again: a broker that restarts may have forgotten them."""
        self._texts.clear()

    async def publish(self, client: aiomqtt.Client, topic: str, text: str, *, qos: int = 0) -> None:
        """Publish a text unless it is on the broker already."""
        if self._texts.get(topic) != text:
            self._topics.add(topic)
            await client.publish(topic, text, qos=qos, retain=True)
            self._texts[topic] = text

    async def clear_others(self, client: aiomqtt.Client, topics: Iterable[str]) -> None:
        """Remove the messages of all topics but these from the broker."""
        for topic in sorted(self._topics.difference(topics)):
            await client.publish(topic, b"", qos=1, retain=True)
            self._topics.discard(topic)
            self._texts.pop(topic, None)
