"""Rule-based controller that keeps comfort bands, for any building."""

from __future__ import annotations

from datetime import datetime, timedelta

from zenostat.agent_sdk.controllers.action_roles import SETPOINTS, ActionBinding, Role, bind_actions
from zenostat.agent_sdk.controllers.base import Controller, Values
from zenostat.agent_sdk.controllers.comfort_band import Band, apart, comfort_bands, default_setback, inside
from zenostat.agent_sdk.controllers.demand_limiting import DemandLimiter
from zenostat.agent_sdk.controllers.occupancy_times import OccupancyTimes
from zenostat.agent_sdk.controllers.optimum_start import OptimumStart
from zenostat.agent_sdk.controllers.parameters import ControllerMismatch, number
from zenostat.agent_sdk.controllers.plant import PlantRules
from zenostat.agent_sdk.controllers.price_peaks import PriceShifts
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.arrays import Floats
from zenostat.topics.energyplus_names import OUTDOOR_TEMPERATURE
from zenostat.topics.messages import Manifest
from zenostat.topics.points import value_index


class RuleBasedController(Controller):
    """Keep zones within the day's comfort band while they are occupied, and set them back otherwise.

    While the zones of an action are occupied, its setpoint is `margin` inside the limit of the band; otherwise it is
    `setback` outside (night setback), within the action's bounds. Zones are occupied while there are people in any of
    them. Zones without an occupant count follow all other zones; if no zone has one, all are always occupied.
    Preconditioning starts `preconditioning` hours before the time of the first arrival on the day before; until the
    first arrival is observed, zones count as occupied from 6 to 22 o'clock.

    Further rules are off by default:

    - `start_rate` replaces the fixed preconditioning time by an optimum start; see `OptimumStart`.
    - `limit_cooling`, `limit_heating`: demand limiting; see `DemandLimiter`.
    - `precooling`, `preheating`: occupied zones are cooled or heated beyond their setpoints before hours of high
      prices, and `shed_cooling`, `shed_heating`: setpoints are relaxed during these hours; see `PriceShifts`.

    `PlantRules` controls water temperatures, availabilities and storage. Other actions are not commanded.

    Args:
        manifest: manifest of the node.
        low: lower limit of the comfort band, degC; None: that of the task's reward, or of `LinearReward`.
        high: upper limit, degC.
        margin: margin, K, since zones overshoot their setpoints; None: 1, but at most a third of the band.
        heating_margin: margin of heating setpoints, K; negative: outside the band; None: `margin`.
        cooling_margin: margin of cooling setpoints, K; None: `margin`.
        setback: setback, K; None: 6 if the task's reward counts comfort only in occupied zones (`OccupiedComfort`),
            else 1.
        heating_setback: setback of heating setpoints, K; None: `setback`.
        cooling_setback: setback of cooling setpoints, K; None: `setback`.
        preconditioning: preconditioning time, h, 0 to 23.
        occupancy_threshold: share of the largest number of people in the zones so far, 0 to 1, above which they count
            as occupied; 0: anybody occupies them, 1: nobody does.
        start_rate: rate at which zones recover from the setback, K/h; None: `preconditioning` applies.
        start_outdoor: additional time for each kelvin between the heating setpoint and the outdoor temperature, h/K.
        start_longest: greatest preconditioning time of the optimum start, h, 0 to 23.
        start_learning: weight of each day's measured rate, 0 to 1; 0: `start_rate` is kept.
        limit_cooling: raise of cooling setpoints at the demand limit, K.
        limit_heating: lowering of heating setpoints at the demand limit, K.
        limit_kw: demand limit, kW; the peak of the month so far if that is higher.
        limit_start: share of the limit from which on setpoints give way, 0 to 1.
        precooling: lowering of cooling setpoints before hours of high prices, K.
        preheating: raise of heating setpoints before these hours, K.
        price_lead: time before these hours, h, 0 to 12.
        shed_cooling: raise of cooling setpoints during these hours, K.
        shed_heating: lowering of heating setpoints during these hours, K.

    Raises:
        InvalidConfig: the task has no action that these rules support, a parameter is invalid, or the node lacks what
            a rule needs: outdoor temperature, electricity meter or price.
    """

    def __init__(
        self,
        manifest: Manifest,
        *,
        low: float | None = None,
        high: float | None = None,
        margin: float | None = None,
        heating_margin: float | None = None,
        cooling_margin: float | None = None,
        setback: float | None = None,
        heating_setback: float | None = None,
        cooling_setback: float | None = None,
        preconditioning: float = 1.0,
        occupancy_threshold: float = 0.0,
        start_rate: float | None = None,
        start_outdoor: float = 0.0,
        start_longest: float = 3.0,
        start_learning: float = 0.0,
        limit_cooling: float = 0.0,
        limit_heating: float = 0.0,
        limit_kw: float = 0.0,
        limit_start: float = 0.9,
        precooling: float = 0.0,
        preheating: float = 0.0,
        price_lead: float = 2.0,
        shed_cooling: float = 0.0,
        shed_heating: float = 0.0,
    ) -> None:
        super().__init__(manifest)
        self._band = comfort_bands(manifest, low, high)
        self._margin_k = None if margin is None else number("margin", margin, minimum=0.0)
        self._margins = tuple(
            None if value is None else number(name, value)
            for name, value in (("heating_margin", heating_margin), ("cooling_margin", cooling_margin))
        )
        setback_k = default_setback(manifest) if setback is None else number("setback", setback, minimum=0.0)
        self._setbacks_k = tuple(
            setback_k if value is None else number(name, value, minimum=0.0)
            for name, value in (("heating_setback", heating_setback), ("cooling_setback", cooling_setback))
        )
        self._preconditioning = timedelta(hours=number("preconditioning", preconditioning, minimum=0.0, maximum=23.0))
        threshold = number("occupancy_threshold", occupancy_threshold, minimum=0.0, maximum=1.0)
        self._bindings = tuple(b for b in bind_actions(manifest) if b.role is not Role.OTHER)
        if not self._bindings:
            raise ControllerMismatch(
                f"the rule-based controller needs an action that sets a heating or cooling setpoint, a water "
                f"temperature, an availability or a storage; node {manifest.node!r} has none"
            )
        self._plant = PlantRules(self._margin_k)
        self._occupancy = OccupancyTimes(manifest.timestep, threshold)
        self._start = self._optimum_start(start_rate, start_outdoor, start_longest, start_learning)
        self._outdoor = _outdoor_index(manifest) if self._start is not None and self._start.outdoor_h_per_k else None
        self._limit_k = (
            number("limit_heating", limit_heating, minimum=0.0),
            number("limit_cooling", limit_cooling, minimum=0.0),
        )
        limit = number("limit_kw", limit_kw, minimum=0.0), number("limit_start", limit_start, minimum=0.0, maximum=1.0)
        self._limiter = DemandLimiter(manifest, *limit, max(self._limit_k)) if any(self._limit_k) else None
        self._shifts = PriceShifts(
            manifest,
            precooling=precooling,
            preheating=preheating,
            price_lead=price_lead,
            shed_cooling=shed_cooling,
            shed_heating=shed_heating,
        )

    @staticmethod
    def _optimum_start(rate: float | None, outdoor: float, longest: float, learning: float) -> OptimumStart | None:
        outdoor_h_per_k = number("start_outdoor", outdoor, minimum=0.0)
        limit = timedelta(hours=number("start_longest", longest, minimum=0.0, maximum=23.0))
        weight = number("start_learning", learning, minimum=0.0, maximum=1.0)
        if rate is None:
            return None
        return OptimumStart(number("start_rate", rate, minimum=0.01), outdoor_h_per_k, limit, weight)

    def begin(self, sample: SampleView) -> None:  # noqa: ARG002
        """Reset the arrival times and what was learned from them, the peak, and the state of the availabilities."""
        self._occupancy.begin()
        self._plant.begin()
        if self._start is not None:
            self._start.begin()
        if self._limiter is not None:
            self._limiter.begin()

    def act(self, sample: SampleView) -> Values:
        """Return the setpoints and plant values for the timestep that begins at `sample.time`."""
        now, measured = sample.time, sample.values
        band = self._band(now)
        comfort = self._occupied_setpoints(band)
        empty = (min(band[0] - self._setbacks_k[0], comfort[0]), max(band[1] + self._setbacks_k[1], comfort[1]))
        heating, cooling = self._shifts.at(now)
        occupied = apart((comfort[0] + heating, comfort[1] + cooling))
        share = 0.0 if self._limiter is None else self._limiter.share(measured, now)
        values: Values = {}
        for binding in self._bindings:
            if binding.role in SETPOINTS:
                is_in_use = self._is_occupied(binding, comfort, measured, now)
                low, high = occupied if is_in_use else empty
                if share:
                    low, high = low - share * self._limit_k[0], high + share * self._limit_k[1]
                values |= binding.at(low if binding.role is Role.HEATING else high)
            else:
                values |= self._plant.act(binding, measured, band)
        return values

    def _occupied_setpoints(self, band: Band) -> Band:
        """Return heating and cooling setpoint of occupied zones; they meet in the middle where they would cross."""
        low, high = inside(band, self._margin_k)
        heating, cooling = self._margins
        if heating is None and cooling is None:
            return low, high
        return apart((low if heating is None else band[0] + heating, high if cooling is None else band[1] - cooling))

    def _is_occupied(self, binding: ActionBinding, comfort: Band, measured: Floats, now: datetime) -> bool:
        """Return whether an action's zones are occupied, or are preconditioned for people who are expected."""
        people = binding.people
        if self._start is not None:
            self._start.observe(binding.action.name, self._distance_k(binding, comfort, measured), now)
        return self._occupancy.is_occupied(
            people, measured, now, lambda arrival: self._is_started(binding, comfort, measured, arrival, now)
        )

    def _is_started(
        self, binding: ActionBinding, comfort: Band, measured: Floats, expected: datetime, now: datetime
    ) -> bool:
        if self._start is None or not binding.temperatures:
            return expected - self._preconditioning <= now
        colder_k = 0.0
        if self._outdoor is not None and binding.role is Role.HEATING:
            colder_k = comfort[0] - float(measured[self._outdoor])
        distance_k = self._distance_k(binding, comfort, measured)
        return self._start.is_started(binding.action.name, distance_k, colder_k, expected, now)

    def _distance_k(self, binding: ActionBinding, comfort: Band, measured: Floats) -> float:
        """Return the distance of the action's worst zone to its occupied setpoint, K; at most 0 if there is none."""
        if not binding.temperatures:
            return 0.0
        zones = measured[list(binding.temperatures)]
        if binding.role is Role.HEATING:
            return binding.clip(comfort[0]) - float(zones.min())
        return float(zones.max()) - binding.clip(comfort[1])


def _outdoor_index(manifest: Manifest) -> int:
    for sensor in manifest.sensors:
        if sensor.variable.casefold() == OUTDOOR_TEMPERATURE.casefold():
            return value_index(manifest)[sensor.name]
    raise ControllerMismatch(
        f"start_outdoor needs the outdoor temperature: add ({OUTDOOR_TEMPERATURE!r}, 'Environment') to sensors= of "
        f"node {manifest.node!r}"
    )
