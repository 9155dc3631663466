"""A controller for the plant in own_plant.py: the same two days with a hot tank, and with a heating curve.

Run it: `python examples/own_plant_controller.py`

Or start the plant with `zenostat node --plant examples/own_plant.py:HeatPumpRoom --name room`, and then, in another
terminal: `zenostat run --node room --controller examples/own_plant_controller.py:HeatingCurve`
"""

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import gymnasium as gym

from zenostat import Manifest, SampleView
from zenostat.controllers import Agent, Controller, Values


class HeatingCurve(Controller):
    """Keep the room at 20 degC with water that is the warmer, the colder it is outdoors.

    In steady state the radiators balance the walls: u UA_radiator (T_tank - 20) = UA_wall (20 - T_outdoor), and
    UA_wall / UA_radiator is 0.43. With u = 0.8, the tank needs 20 + 0.54 (20 - T_outdoor). The cooler the water, the
    higher the COP. `slope=0` and `base` keep the tank at a constant temperature instead.
    """

    def __init__(self, manifest: Manifest, *, base: float = 20.0, slope: float = 0.54) -> None:
        super().__init__(manifest)
        self.base, self.slope = base, slope

    def act(self, sample: SampleView) -> Values:
        """Return the power of the compressor in W and the share of circulation."""
        water = self.base + self.slope * (20.0 - sample["outdoor_temperature"])
        power = 1000.0 * (water - sample["tank_temperature"])
        circulation = 0.8 + 1.0 * (20.0 - sample["room_temperature"])
        return {"compressor": min(max(power, 0.0), 2000.0), "circulation": min(max(circulation, 0.0), 1.0)}


def energy_and_comfort(values: Mapping[str, float], begin: datetime) -> dict[str, float]:  # noqa: ARG001
    """Return reward terms: kWh of electricity, and degree-hours below 19.5 degC."""
    too_cold = max(19.5 - values["room_temperature"], 0.0)
    return {"energy": -values["electricity"] / 3.6e6, "comfort": -too_cold / 60.0}


def main() -> None:
    """Run an episode with each of two controllers, on the same weather."""
    plant = f"{Path(__file__).with_name('own_plant.py')}:HeatPumpRoom"
    env = gym.make("zenostat:zenostat/Plant-v1", plant=plant, reward=energy_and_comfort)
    manifest = env.unwrapped.manifest
    controllers = {"tank at 50 degC": HeatingCurve(manifest, base=50.0, slope=0.0), "curve": HeatingCurve(manifest)}
    for name, controller in controllers.items():
        env.reset(seed=1)
        agent, terms, truncated = Agent(controller), {"energy": 0.0, "comfort": 0.0}, False
        while not truncated:
            _, _, _, truncated, info = env.step(agent.action(env.unwrapped.sample))
            terms = {term: total + info["reward_terms"][term] for term, total in terms.items()}
        print(f"{name}: {abs(terms['energy']):.1f} kWh, {abs(terms['comfort']):.2f} K h too cold at {info['time']}")
    env.close()


if __name__ == "__main__":
    main()
