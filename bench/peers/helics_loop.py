"""The loop as two HELICS federates in two processes: `python -m bench.peers.helics_loop office|law OPTIONS`.

With the scheme `delay`, the times of the law's federate lie half a step after those of the office, so the setpoint
follows the power of the step before. With `iterate`, both iterate at the same time: a federate that has new input
computes and publishes again; the law does not publish once its setpoint is within the tolerance, and HELICS then grants
the next time. `damping` is the part of the change that the law takes; with 1, the iteration is substitution.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import helics as h

from bench.peers import model

IF_NEEDED = h.helics_iteration_request_iterate_if_needed
IS_ITERATING = h.helics_iteration_result_iterating


def federate(name: str, publishes: str, reads: str, options: dict[str, Any], offset: float) -> tuple[Any, Any, Any]:
    """Return a federate, its publication and its input."""
    info = h.helicsCreateFederateInfo()
    h.helicsFederateInfoSetCoreTypeFromString(info, options["core"])
    h.helicsFederateInfoSetCoreInitString(info, f"--federates=1 --brokerport={options['port']}")
    h.helicsFederateInfoSetTimeProperty(info, h.helics_property_time_period, 1.0)
    h.helicsFederateInfoSetTimeProperty(info, h.helics_property_time_offset, offset)
    h.helicsFederateInfoSetIntegerProperty(info, h.helics_property_int_max_iterations, 4 * model.LIMIT)
    fed = h.helicsCreateValueFederate(name, info)
    publication = h.helicsFederateRegisterGlobalPublication(fed, publishes, h.HELICS_DATA_TYPE_DOUBLE)
    return fed, publication, h.helicsFederateRegisterSubscription(fed, reads)


def run_office(options: dict[str, Any]) -> None:
    """Simulate the office, and write what it did."""
    broker = h.helicsCreateBroker(options["core"], "", f"--federates=2 --port={options['port']}")
    fed, publication, subscription = federate("office", "power", "setpoint", options, 0.0)
    h.helicsFederateEnterExecutingMode(fed)
    day, temperature, setpoint = model.Day(), model.START_DEGC, model.MIDDLE_DEGC
    h.helicsFederateRequestTime(fed, 1.0)
    for step in range(1, options["steps"] + 1):
        if h.helicsInputIsUpdated(subscription):
            setpoint = h.helicsInputGetDouble(subscription)
        while True:
            power, end = model.office(temperature, step, setpoint)
            day.evaluations += 1
            h.helicsPublicationPublishDouble(publication, power)
            if options["scheme"] == "delay":
                h.helicsFederateRequestTime(fed, step + 1.0)
                break
            state = IS_ITERATING
            while state == IS_ITERATING and not h.helicsInputIsUpdated(subscription):
                _, state = h.helicsFederateRequestTimeIterative(fed, step + 1.0, IF_NEEDED)
            if state != IS_ITERATING:
                break
            setpoint = h.helicsInputGetDouble(subscription)
        day.add(setpoint, power)
        temperature = end
    h.helicsFederateDisconnect(fed)
    h.helicsBrokerWaitForDisconnect(broker, 5000)
    day.write(options["output"])


def run_law(options: dict[str, Any]) -> None:
    """Return setpoints until the office has disconnected."""
    offset = 0.5 if options["scheme"] == "delay" else 0.0
    fed, publication, subscription = federate("law", "setpoint", "power", options, offset)
    h.helicsFederateEnterExecutingMode(fed)
    setpoint, granted = model.MIDDLE_DEGC, 0.0
    if options["scheme"] == "delay":
        while granted < options["steps"]:
            granted = h.helicsFederateRequestTime(fed, granted + 1.0)
            setpoint = model.law(h.helicsInputGetDouble(subscription), options["gain"])
            h.helicsPublicationPublishDouble(publication, setpoint)
    else:
        granted, count = h.helicsFederateRequestTime(fed, 1.0), 0
        while granted < options["steps"] + 1:
            granted, state = h.helicsFederateRequestTimeIterative(fed, granted + 1.0, IF_NEEDED)
            if state != IS_ITERATING:
                count = 0
            elif h.helicsInputIsUpdated(subscription):
                count += 1
                change = model.law(h.helicsInputGetDouble(subscription), options["gain"]) - setpoint
                if abs(change) > model.TOLERANCE_K and count < model.LIMIT:
                    setpoint += options["damping"] * change
                    h.helicsPublicationPublishDouble(publication, setpoint)
    h.helicsFederateDisconnect(fed)


if __name__ == "__main__":
    {"office": run_office, "law": run_law}[sys.argv[1]](json.loads(sys.argv[2]))
    h.helicsCloseLibrary()
