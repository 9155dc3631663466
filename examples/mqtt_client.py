"""A night setback that speaks MQTT. It needs `pip install paho-mqtt` and a broker, for example mosquitto.

    zenostat node --building ref-small-office --weather USA_CO_Denver --begin 07-03 --end 07-03 --name office --mode paced --speed 3600
    zenostat gateway mqtt office --broker 127.0.0.1:1883
    python examples/mqtt_client.py

From 20:00 to 6:00 it raises the cooling setpoint of a zone; by day it relinquishes it.
"""  # noqa: E501

from __future__ import annotations

import argparse
import json
from datetime import datetime
from typing import Any

import paho.mqtt.client as mqtt

ROOT = "zenostat/office"
SETPOINT = "core_zn_cooling_setpoint"
NIGHT_DEGC = 28.0


def main() -> None:
    """Control the zone until the episode is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=1883)
    arguments = parser.parse_args()
    was_night: bool | None = None

    def on_connect(client: mqtt.Client, *_: Any) -> None:
        client.subscribe([(f"{ROOT}/sample", 0), (f"{ROOT}/actuator/{SETPOINT}/result", 1)])

    def on_message(client: mqtt.Client, _: Any, message: mqtt.MQTTMessage) -> None:
        nonlocal was_night
        content = json.loads(message.payload)
        if message.topic.endswith("/result"):
            print(f"  {content['message']}")
            return
        hour = datetime.fromisoformat(content["time"]).hour
        is_night = hour >= 20 or hour < 6
        if is_night != was_night:
            was_night = is_night
            print(f"{content['time']}: {'night' if is_night else 'day'}")
            command = json.dumps({"value": NIGHT_DEGC, "source": "night_setback"}) if is_night else ""
            client.publish(f"{ROOT}/actuator/{SETPOINT}/set", command, qos=1)
        if content["last"]:
            client.disconnect()

    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.on_connect, client.on_message = on_connect, on_message
    client.on_subscribe = lambda *_: print("subscribed")
    client.connect("127.0.0.1", arguments.port)
    client.loop_forever()


if __name__ == "__main__":
    main()
