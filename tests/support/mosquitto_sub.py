"""Part of mosquitto_sub, as a program for machines without it: `-p PORT -v -t TOPIC …`."""

import argparse

import paho.mqtt.client as paho
import paho.mqtt.subscribe as subscribe


def show(_: paho.Client, __: object, message: paho.MQTTMessage) -> None:
    print(message.topic, message.payload.decode(), flush=True)  # noqa: T201


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("-p", dest="port", type=int, required=True)
    parser.add_argument("-v", action="store_true")
    parser.add_argument("-t", dest="topics", action="append", required=True)
    options = parser.parse_args()
    subscribe.callback(  # type: ignore[no-untyped-call]
        show, options.topics, port=options.port, protocol=paho.MQTTv5, clean_session=None
    )
