"""Discovery messages of Home Assistant, so that a node's points appear there by themselves."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any
from zlib import crc32

from zenostat.gateways.mqtt.topic_names import PREFIX
from zenostat.gateways.points import Reading, readings
from zenostat.metrics.labels import label
from zenostat.metrics.roles import roles
from zenostat.topics.messages import Actuator, Manifest

_UNITS = {"degC": "°C", "percent": "%", "W": "W", "kW": "kW", "MW": "MW", "Wh": "Wh", "kWh": "kWh", "MWh": "MWh",
          "Pa": "Pa", "ppm": "ppm", "m/s": "m/s", "W/m2": "W/m²", "lux": "lx", "kg/s": "kg/s",
          "m3/s": "m³/s"}  # fmt: skip
_CLASSES = {"degC": "temperature", "W": "power", "kW": "power", "MW": "power", "Pa": "pressure",
            "ppm": "carbon_dioxide", "m/s": "wind_speed", "W/m2": "irradiance", "lux": "illuminance"}  # fmt: skip


_COMPONENTS = ("sensor", "number", "button", "climate")


def discovery_topics(prefix: str) -> list[str]:
    """Return the topics of all discovery messages of the components that `discovery` publishes, with wildcards."""
    return [f"{prefix}/{component}/+/config" for component in _COMPONENTS]


def is_discovery(payload: bytes, root: str) -> bool:
    """Return whether a payload is a discovery message of the gateway with a root."""
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError):
        return False
    return isinstance(content, dict) and content.get("availability_topic") == f"{root}/status"


def discovery(manifest: Manifest, root: str, prefix: str = "homeassistant") -> Iterator[tuple[str, str]]:
    """Yield topic and payload of each discovery message.

    Sensors and meters are sensors. An actuator is a number, with a button that relinquishes it. A zone whose
    temperature and both setpoints are points is a climate entity in addition.

    Args:
        manifest: the node's manifest.
        root: the gateway's topic of the node, below which its topics are.
        prefix: Home Assistant's discovery prefix.
    """
    ids = _ids(manifest, root, [reading.name for reading in readings(manifest)])
    for reading in readings(manifest):
        kind = "sensor" if reading.index < len(manifest.sensors) else "meter"
        content = _entity(manifest, root, ids[reading.name], label(reading.name)) | _quantity(reading)
        content |= {"state_topic": f"{root}/{kind}/{reading.name}", "state_class": "measurement"}
        content["value_template"] = "{{ 'None' if value == 'null' else value }}"  # its word for an unknown state
        yield f"{prefix}/sensor/{ids[reading.name]}/config", json.dumps(content)
    actuator_ids = _ids(manifest, root, [actuator.name for actuator in manifest.actuators])
    for actuator in manifest.actuators:
        number = _number(manifest, root, actuator, actuator_ids[actuator.name])
        yield f"{prefix}/number/{number['unique_id']}/config", json.dumps(number)
        button = _button(manifest, root, actuator, actuator_ids[actuator.name])
        yield f"{prefix}/button/{button['unique_id']}/config", json.dumps(button)
    climate_ids = _ids(manifest, root, [reading.name for reading in readings(manifest)], "climate_")
    for zone in roles(manifest).zones:
        if zone.temperature is None or zone.heating_actuator is None or zone.cooling_actuator is None:
            continue
        content = _entity(manifest, root, climate_ids[manifest.points[zone.temperature].name], zone.label)
        content |= _climate(manifest, root, zone.temperature, zone.heating_actuator, zone.cooling_actuator)
        yield f"{prefix}/climate/{content['unique_id']}/config", json.dumps(content)


def _climate(manifest: Manifest, root: str, air: int, heating: int, cooling: int) -> dict[str, Any]:
    temperature = manifest.points[air].name
    content: dict[str, Any] = {
        "current_temperature_topic": f"{root}/sensor/{temperature}",
        "modes": ["heat_cool"],
        "mode_state_topic": f"{root}/status",
        "mode_state_template": "heat_cool",
        "temperature_unit": "C",
        "temp_step": 0.5,
        "precision": 0.1,
    }
    actuators = {"low": manifest.actuators[heating], "high": manifest.actuators[cooling]}
    for side, actuator in actuators.items():
        content[f"temperature_{side}_state_topic"] = f"{root}/actuator/{actuator.name}"
        content[f"temperature_{side}_command_topic"] = f"{root}/actuator/{actuator.name}/set"
        content[f"temperature_{side}_command_template"] = _limited(actuator)
    # Home Assistant has one range for both targets; the templates keep each within its own actuator's bounds.
    lows = [actuator.low for actuator in actuators.values() if actuator.low is not None]
    highs = [actuator.high for actuator in actuators.values() if actuator.high is not None]
    content |= {"min_temp": min(lows)} if len(lows) == len(actuators) else {}
    content |= {"max_temp": max(highs)} if len(highs) == len(actuators) else {}
    return content


def _limited(actuator: Actuator) -> str:
    """Return the template of a command: the value, or the bound of the actuator that it exceeds."""
    text = "value | float"
    if actuator.low is not None:
        text = f"[{text}, {actuator.low}] | max"
    if actuator.high is not None:
        text = f"[{text}, {actuator.high}] | min"
    return f"{{{{ {text} }}}}"


def _device_id(manifest: Manifest, root: str) -> str:
    """Return the id of the node's device; a checksum of the topic follows where it does not follow from the id."""
    text = f"zenostat_{manifest.node}".replace(".", "_")
    is_plain = root == f"{PREFIX}/{manifest.node}" and "." not in manifest.node
    return text if is_plain else f"{text}_{crc32(root.encode()):08x}"


def _ids(manifest: Manifest, root: str, names: Iterable[str], prefix: str = "") -> dict[str, str]:
    """Return the id of each name, in which Home Assistant allows no dots.

    Where two names would have one id, a checksum follows in that of each name with dots; it depends on the name alone.
    """
    ids = {name: f"{_device_id(manifest, root)}_{prefix}{name}".replace(".", "_") for name in names}
    counts = Counter(ids.values())
    return {
        name: f"{text}_{crc32(name.encode()):08x}" if counts[text] > 1 and "." in name else text
        for name, text in ids.items()
    }


def _entity(manifest: Manifest, root: str, identifier: str, title: str) -> dict[str, Any]:
    return {
        "name": title,
        "unique_id": identifier,
        "availability_topic": f"{root}/status",
        "device": {
            "identifiers": [_device_id(manifest, root)],
            "name": manifest.node,
            "model": manifest.building,
            "manufacturer": "Zenostat",
            "sw_version": manifest.versions.zenostat,
        },
    }


def _quantity(reading: Reading) -> dict[str, Any]:
    content: dict[str, Any] = {}
    if reading.unit in _UNITS:
        content["unit_of_measurement"] = _UNITS[reading.unit]
    if reading.unit in _CLASSES:
        content["device_class"] = _CLASSES[reading.unit]
    elif reading.unit == "percent" and "humidity" in reading.name:
        content["device_class"] = "humidity"
    return content


def _number(manifest: Manifest, root: str, actuator: Actuator, identifier: str) -> dict[str, Any]:
    topic = f"{root}/actuator/{actuator.name}"
    content = _entity(manifest, root, identifier, label(actuator.name))
    content |= {"state_topic": topic, "command_topic": f"{topic}/set", "mode": "box", "payload_reset": "null"}
    content["min"] = -1e9 if actuator.low is None else actuator.low
    content["max"] = 1e9 if actuator.high is None else actuator.high
    content["step"] = 0.1 if actuator.unit == "degC" else 0.001
    if actuator.unit in _UNITS:
        content["unit_of_measurement"] = _UNITS[actuator.unit]
    return content


def _button(manifest: Manifest, root: str, actuator: Actuator, identifier: str) -> dict[str, Any]:
    """Return the button that relinquishes an actuator: it sends a value of null."""
    content = _entity(manifest, root, f"{identifier}_relinquish", f"{label(actuator.name)} relinquish")
    return content | {"command_topic": f"{root}/actuator/{actuator.name}/set", "payload_press": "null"}
