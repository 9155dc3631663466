"""Retained messages of a gateway on its broker."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from zenostat.gateways.mqtt.broker import BrokerClient
from zenostat.gateways.points import readings
from zenostat.topics.messages import Manifest


def point_topics(manifest: Manifest, root: str) -> list[str]:
    """Return the topic of each sensor, meter and actuator below a root, in the manifest's order."""
    count = len(manifest.sensors)
    return [
        *(f"{root}/{'sensor' if r.index < count else 'meter'}/{r.name}" for r in readings(manifest)),
        *(f"{root}/actuator/{actuator.name}" for actuator in manifest.actuators),
    ]


def stored_topics(root: str) -> list[str]:
    """Return the topics below a root, with wildcards, where a former gateway may have left retained values."""
    return [f"{root}/{kind}/+" for kind in ("sensor", "meter", "actuator")]


class RetainedMessages:
    """The retained messages of a gateway on its broker, so that it publishes changes only."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._topics: set[str] = set()

    def reconnected(self) -> None:
        """Publish all of them again: a broker that restarts may have forgotten them."""
        self._texts.clear()

    def add_stored(self, topic: str) -> bool:
        """Add a topic of which the broker has a message; return whether it was not known."""
        is_new = topic not in self._topics
        self._topics.add(topic)
        return is_new

    async def publish(self, client: BrokerClient, topic: str, text: str, *, qos: int = 0) -> None:
        """Publish a text unless it is on the broker already."""
        if self._texts.get(topic) != text:
            self._topics.add(topic)
            await client.send(topic, text, qos=qos, retain=True)
            self._texts[topic] = text

    async def publish_all(self, client: BrokerClient, texts: Iterable[tuple[str, str]]) -> None:
        """Publish texts by topic unless they are on the broker already, without waiting for one after another."""
        changed = [(topic, text) for topic, text in texts if self._texts.get(topic) != text]
        first = [self.publish(client, topic, text) for topic, text in changed if topic not in self._texts]
        await asyncio.gather(*first)  # the broker confirms these
        for topic, text in changed:
            await self.publish(client, topic, text)

    async def clear_others(self, client: BrokerClient, topics: Iterable[str]) -> None:
        """Remove the messages of all topics but these from the broker."""
        for topic in sorted(self._topics.difference(topics)):
            await client.send(topic, b"", qos=1, retain=True)
            self._topics.discard(topic)
            self._texts.pop(topic, None)
