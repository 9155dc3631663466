"""Districts of Python plants that are simulated in microseconds, as files."""

from pathlib import Path

PLANTS = '''
class House:
    """A house with a heater and a meter: its power is what the heater and its residents draw."""

    step_s, duration_s, forkable = 900.0, 9000.0, True
    time = ("hour",)
    sensors = {"temperature": ("degC", -50.0, 100.0), "draw": ("W", 0.0, 1e5)}
    meters = {"electricity": ("J", 0.0, None)}
    actuators = {"heater": ("W", 0.0, 4000.0, 1000.0)}

    def __init__(self, residents_w=500.0):
        self.residents_w = residents_w

    def reset(self, seed):
        self.temperature, self.step_number = 18.0 + seed % 11 / 11, 0
        return self.values(0.0)

    def step(self, commands):
        self.step_number += 1
        self.temperature += (commands["heater"] - 100.0 * self.temperature) * 900.0 / 1e7
        return self.values(commands["heater"] + self.residents_w * (1 + self.step_number % 3))

    def values(self, power):
        return {"temperature": self.temperature, "draw": power, "electricity": 900.0 * power}


class Feeder:
    """A feeder of 8 kW with PV and a battery without losses; its price is that of the coming timestep."""

    step_s, duration_s, forkable = 900.0, 9000.0, True
    sensors = {
        "import": ("W", 0.0, 1e6), "export": ("W", 0.0, 1e6), "loading": ("percent", 0.0, None),
        "battery_state_of_charge": ("fraction", 0.0, 1.0), "battery_power": ("W", -4000.0, 4000.0),
        "pv_power": ("W", 0.0, None), "car_power": ("W", 0.0, 11000.0), "car_needed": ("J", 0.0, None),
        "car_departure": ("s", 0.0, None), "price": ("EUR/kWh", None, None),
    }
    actuators = {
        "east": ("W", 0.0, 1e5, 0.0), "west": ("W", 0.0, 1e5, 0.0), "battery_setpoint": ("W", -4000.0, 4000.0, 0.0),
        "car_limit": ("W", 0.0, 11000.0, 11000.0),
    }
    actions = ("battery_setpoint", "car_limit")

    def reset(self, seed):
        self.energy, self.need, self.count = 9e6, 7.2e6, 0
        return self.values(0.0, 0.0, 0.0, 0.0)

    def step(self, commands):
        self.count += 1
        wanted = commands["battery_setpoint"] * 900.0
        stored = min(max(wanted, -self.energy), 1.8e7 - self.energy)
        self.energy += stored
        car = min(commands["car_limit"] * 900.0, self.need)
        self.need -= car
        sun = 3000.0 if self.count > 5 else 0.0
        net = commands["east"] + commands["west"] + (stored + car) / 900.0 - sun
        return self.values(net, stored / 900.0, sun, car / 900.0)

    def values(self, net, battery, sun, car):
        return {
            "import": max(net, 0.0), "export": max(-net, 0.0), "loading": abs(net) / 80.0,
            "battery_state_of_charge": self.energy / 1.8e7, "battery_power": battery, "pv_power": sun,
            "car_power": car, "car_needed": self.need, "car_departure": max(9000.0 - 900.0 * self.count, 0.0),
            "price": 0.1 * (1 + self.count % 4),
        }


class Uncopied(House):
    forkable = False
'''

DISTRICT = """name: quarter
timestep: 15min
reward:
  kind: district
  consumption: feeder.import
  generation: feeder.export
  limits: [{point: feeder.loading, high: 100}]
  price: feeder.price
plants:
  east: {plant: "plants.py:House"}
  west: {plant: "plants.py:House", plant_arguments: {residents_w: 900.0}}
  feeder: {plant: "plants.py:Feeder"}
connections:
  - {from: east.draw, to: feeder.east}
  - {from: west.draw, to: feeder.west}
"""
"""Two houses and a feeder, ten timesteps."""

STEPS = 10


def write_district(folder: Path, text: str = DISTRICT) -> Path:
    """Write a district with its plants to a folder; return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plants.py").write_text(PLANTS)
    (folder / "district.yaml").write_text(text)
    return folder / "district.yaml"
