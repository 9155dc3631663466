"""Order and loss of what the MQTT gateway publishes, without a broker."""

from types import SimpleNamespace

import pytest

from zenostat.gateways.mqtt.broker import Broker
from zenostat.gateways.mqtt.gateway import MAX_WAITING, MqttGateway
from zenostat.topics.messages import Event, EventKind


@pytest.fixture
def gateway() -> MqttGateway:
    return MqttGateway(SimpleNamespace(name="office"), Broker("localhost", 1883))


async def test_mqtt__points_have_their_turn_while_samples_keep_coming(
    gateway: MqttGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Turn(Exception):
        """The points are published."""

    async def publish_state(_: object) -> None:
        pass

    async def publish_points(_: object) -> None:
        raise Turn

    class FreeNode:
        """A broker's client; the node has a new sample whenever one is sent."""

        sent = 0

        async def send(self, *_: object) -> bool:
            self.sent += 1
            assert self.sent <= 3
            gateway._samples.append("{}")
            return True

    monkeypatch.setattr(gateway, "_publish_state", publish_state)
    monkeypatch.setattr(gateway, "_publish_points", publish_points)
    gateway._samples.extend(["{}"] * 3)
    gateway._has_output.set()
    with pytest.raises(Turn):
        await gateway._publish(FreeNode())
    assert len(gateway._samples) == 3


def test_mqtt__events_that_are_dropped_are_counted(gateway: MqttGateway) -> None:
    for number in range(MAX_WAITING + 5):
        gateway._on_event(Event(kind=EventKind.WRITTEN, text=str(number)))
    assert "5 samples and events dropped" in gateway.summary()
