"""Rules on EMS programs, each with whether EnergyPlus 25.2 ends at the program."""

import shutil
from pathlib import Path

import pytest
from support.box_model import box_model, exit_code

from zenostat.models.building.ems_programs import program_findings

EMS = "EnergyManagementSystem:"
CASES: dict[str, tuple[list[str], str | None]] = {
    "assignment": (["SET a = 1"], None),
    "empty line": (["", "SET a = 1"], None),
    "lower case": (["set a = 1", "if a > 0", "set a = 2", "endif"], None),
    "return a value": (["RETURN 2"], None),
    "function with and without parentheses": (["SET a = @Abs(0-1) + (@Max 2 3)"], None),
    "elseif after else": (["IF 1 > 0", "SET a = 1", "ELSE", "SET a = 2", "ELSEIF 2 > 1", "SET a = 3", "ENDIF"], None),
    "five nested ifs": ([*["IF 1 > 0"] * 5, "SET a = 1", *["ENDIF"] * 5], None),
    "if that ends after the while around it": (
        ["SET a = 0", "WHILE a < 3", "IF a > 1", "SET a = a + 1", "ENDWHILE", "ENDIF"],
        None,
    ),
    "comment in a line of its own": (["! note", "SET a = 1"], "a program has no comments"),
    "comment after a statement": (["SET a = 1 ! note"], "'!' is not expected"),
    "unknown keyword": (["STE a = 1"], "'STE' is no keyword; did you mean 'SET'"),
    "keyword of another language": (["LET a = 1"], "'LET' is no keyword"),
    "keyword without a space": (["SET a = 1", "IF(a > 0)", "SET a = 2", "ENDIF"], "is no keyword"),
    "tabulator after a keyword": (["SET\ta = 1"], "is no keyword"),
    "end if": (["IF 1 > 0", "SET a = 1", "END IF"], "'END' is no keyword"),
    "else if": (["IF 1 > 0", "SET a = 1", "ELSE IF 2 > 1", "SET a = 2", "ENDIF"], "write ELSEIF"),
    "no endif": (["IF 1 > 0", "SET a = 1"], "without an ENDIF"),
    "endif alone": (["SET a = 1", "ENDIF"], "no IF before this ENDIF"),
    "else alone": (["ELSE", "SET a = 1"], "no IF before this ELSE"),
    "elseif alone": (["ELSEIF 1 > 0"], "no IF before this ELSEIF"),
    "two elses": (["IF 1 > 0", "SET a = 1", "ELSE", "SET a = 2", "ELSE", "SET a = 3", "ENDIF"], "an ELSE already"),
    "words after endif": (["IF 1 > 0", "SET a = 1", "ENDIF x"], "nothing may follow ENDIF"),
    "six nested ifs": ([*["IF 1 > 0"] * 6, "SET a = 1", *["ENDIF"] * 6], "more than 5 nested IF"),
    "endwhile alone": (["ENDWHILE"], "no WHILE before this ENDWHILE"),
    "nested whiles": (
        ["SET a = 0", "WHILE a < 1", "WHILE a < 1", "SET a = 1", "ENDWHILE", "ENDWHILE"],
        "a WHILE within another",
    ),
    "if without an expression": (["IF", "SET a = 1", "ENDIF"], "IF needs an expression"),
    "elseif without an expression": (
        ["IF 1 > 0", "SET a = 1", "ELSEIF", "SET a = 2", "ENDIF"],
        "ELSEIF needs an expression",
    ),
    "while without an expression": (["WHILE", "ENDWHILE"], "WHILE needs an expression"),
    "set alone": (["SET"], "SET needs a variable"),
    "set without an equal sign": (["SET a 1"], "SET needs a variable"),
    "set without an expression": (["SET a ="], "SET needs an expression"),
    "parenthesis not closed": (["SET a = (1 + 2"], "a ')' is missing"),
    "parenthesis not opened": (["SET a = 1 + 2)"], "a '(' is missing"),
    "unknown function": (["SET a = 2*@Foo 1"], "there is no function '@Foo'"),
    "single ampersand": (["IF 1 > 0 & 2 > 1", "SET a = 2", "ENDIF"], "'&' is not expected"),
    "unknown operator": (["SET b = 2", "IF b => 1", "SET a = 2", "ENDIF"], "'=' is not expected"),
    "run of an unknown program": (["RUN Nothing"], "there is no program 'Nothing'"),
    "run of nothing": (["RUN"], "there is no program ''"),
}


def model_with(lines: list[str]) -> dict[str, dict[str, dict[str, object]]]:
    model = box_model()
    model[EMS + "Program"] = {"P": {"lines": [{"program_line": line} for line in lines]}}
    model[EMS + "ProgramCallingManager"] = {
        "M": {"energyplus_model_calling_point": "BeginTimestepBeforePredictor", "programs": [{"program_name": "P"}]}
    }
    return model


@pytest.mark.parametrize("case", CASES)
def test_program_findings__error_is_named_with_its_line(case: str) -> None:
    lines, words = CASES[case]
    findings = list(program_findings(model_with(lines)))
    if words is None:
        assert findings == []
    else:
        assert any(words in finding.text for finding in findings)
        assert all(finding.is_fatal and finding.field.startswith("lines[") for finding in findings)


@pytest.mark.slow
@pytest.mark.process
def test_program_findings__agree_with_energyplus(tmp_path: Path) -> None:
    codes = {}
    for case, (lines, _) in CASES.items():
        codes[case] = exit_code(model_with(lines), tmp_path / "run")
        shutil.rmtree(tmp_path / "run")
    assert {case: code != 0 for case, code in codes.items()} == {case: CASES[case][1] is not None for case in CASES}


@pytest.mark.slow
@pytest.mark.process
def test_program_findings__accept_each_function_that_energyplus_has(tmp_path: Path) -> None:
    from zenostat.models.building.ems_programs import FUNCTIONS

    lines = ["IF 0 > 1", *(f"SET a = @{name} 1" for name in FUNCTIONS), "ENDIF"]
    assert list(program_findings(model_with(lines))) == []
    assert exit_code(model_with(lines), tmp_path / "run") == 0


def test_program_findings__while_without_end_is_an_error_since_energyplus_never_ends() -> None:
    (finding,) = program_findings(model_with(["SET a = 0", "WHILE a > 3", "SET a = a + 1"]))
    assert finding.text == (
        f"{EMS}Program 'P': lines[1].program_line begins a WHILE without an ENDWHILE; EnergyPlus would never end it"
    )


def test_program_findings__a_program_that_nothing_calls_is_checked_too() -> None:
    model = box_model()
    model[EMS + "Subroutine"] = {"Q": {"lines": [{"program_line": "SET x = (1"}]}}
    (finding,) = program_findings(model)
    assert (finding.kind, finding.name) == (f"{EMS}Subroutine", "Q")
