"""Severe errors that EnergyPlus reports in a run that goes on."""

from zenostat.eplus_node.engine.severe_errors import SevereErrors

CONTINUED, INFORMATION, WARNING, SEVERE = 0, 1, 2, 3

AT_THE_BEGIN = [
    (WARNING, "Check input. Pump nominal power or motor efficiency is set to 0, for pump=SWHSYS1 PUMP"),
    (CONTINUED, "...of a warning"),
    (SEVERE, 'Node Connection Error, Node="REGIN", The same node appears as a non-parent Inlet node more than once.'),
    (CONTINUED, "Reference Object=Dehumidifier:Desiccant:NoFans, Name=DES"),
    (INFORMATION, "There was 1 node connection error noted."),
    (CONTINUED, "...of something else"),
]
RECURRING = "Improper flow delivered by desiccant regen fan - RESULTS INVALID! Check regen fan capacity and schedule."
AT_THE_END = [
    (INFORMATION, "===== Recurring Error Summary ====="),
    (INFORMATION, f" ** Severe  ** {RECURRING}"),
    (INFORMATION, " **   ~~~   **   This error occurred 13614 total times;"),
    (INFORMATION, " **   ~~~   **   during Warmup 11670 times;"),
    (INFORMATION, " **   ~~~   **   during Sizing 0 times."),
    (SEVERE, f" ** Severe  ** {RECURRING}"),
    (CONTINUED, ""),
    (INFORMATION, " **   ~~~   ** Dehumidifier:Desiccant:NoFans=DES"),
    (CONTINUED, " **   ~~~   ** Dehumidifier:Desiccant:NoFans=DES"),
    (INFORMATION, "EnergyPlus Warmup Error Summary. During Warmup: 0 Warning; 0 Severe Errors."),
    (INFORMATION, "EnergyPlus Completed Successfully-- 5 Warning; 13615 Severe Errors; Elapsed Time=6.83sec"),
]
"""Messages of EnergyPlus 25.2 on a desiccant wheel whose regeneration gets no air."""


def _add(errors: SevereErrors, messages: list[tuple[int, str]]) -> list[str]:
    for level, text in messages:
        errors.add(level, text.encode())
    return errors.drain()


def test_severe_errors__texts_have_their_lines_and_the_number_of_those_that_recur() -> None:
    errors = SevereErrors()
    assert _add(errors, AT_THE_BEGIN) == [
        'EnergyPlus reports a severe error: Node Connection Error, Node="REGIN", The same node appears as a non-parent '
        "Inlet node more than once.; Reference Object=Dehumidifier:Desiccant:NoFans, Name=DES"
    ]
    assert _add(errors, AT_THE_END) == [
        f"EnergyPlus reports a severe error: {RECURRING} (13,614 times); Dehumidifier:Desiccant:NoFans=DES",
        "EnergyPlus counts 13,615 severe errors in this run",
    ]


def test_severe_errors__each_text_once() -> None:
    errors = SevereErrors()
    first = _add(errors, AT_THE_BEGIN)
    assert _add(errors, AT_THE_BEGIN) == []
    assert errors.repeat() == first


def test_severe_errors__of_many_the_first_ones_and_the_total() -> None:
    errors = SevereErrors()
    texts = _add(errors, [*((SEVERE, f"error {number}") for number in range(1000)), AT_THE_END[-1]])
    assert texts[0].endswith("error 0")
    assert len(texts) == 21
    assert texts[-1] == "EnergyPlus counts 13,615 severe errors in this run"


def test_severe_errors__none_in_a_usual_run() -> None:
    end = "EnergyPlus Completed Successfully-- 5 Warning; 0 Severe Errors; Elapsed Time=00hr 00min  0.83sec"
    assert _add(SevereErrors(), [*AT_THE_BEGIN[:2], (INFORMATION, end)]) == []
