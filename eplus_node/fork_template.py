"""The engine that waits at sample 0 so that each episode can be a fork of it."""

from __future__ import annotations

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.engine.spec import EngineSpec
from zenostat.models.scenario.episode_weather import EpisodeFiles, WeatherDraw


class EngineTemplate:
    """The engine with one weather file that waits at sample 0 to be forked; all slots of a node share it.

    Attributes:
        draw: the weather of the engine.
        files: what the engine reads.
        noise_offset: offset in bytes from which the weather file of a fork may differ.
        engine: None if there is none.
        ready: whether the engine has reached sample 0.
    """

    def __init__(self) -> None:
        self.draw = WeatherDraw()
        self.files: EpisodeFiles | None = None
        self.noise_offset = 0
        self.engine: EngineClient | None = None
        self.ready = False

    def has(self, draw: WeatherDraw) -> bool:
        """Whether an engine with this weather is waiting or is starting."""
        return self.engine is not None and self.draw == draw and self.engine.alive

    def replace(self, draw: WeatherDraw, files: EpisodeFiles, engine: EngineClient) -> None:
        """Close the present engine and keep this one, which may not have reached sample 0 yet."""
        self.close()
        self.draw, self.files, self.engine, self.ready = draw, files, engine, False

    def fork(self, spec: EngineSpec) -> EngineClient:
        """Fork the engine; wait until it has reached sample 0.

        Raises:
            SimulatorError: EnergyPlus could not simulate the model, or the engine has died or cannot be forked.
        """
        assert self.engine is not None
        if not self.ready:
            self.engine.receive()
            self.ready = True
        return self.engine.fork(spec)

    def close(self) -> None:
        """End the engine; idempotent."""
        engine, self.engine = self.engine, None
        if engine is not None:
            engine.close()
