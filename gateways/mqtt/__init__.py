"""MQTT: the points of one node as topics of a broker, and commands from its clients."""
