"""Upgrading files: the command, EnergyPlus's transition programs (a program that behaves alike), and a node's model."""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from support.old_versions import as_idf, taken_back
from support.run_cli import run_in_process

from zenostat.models import energyplus
from zenostat.models.building.model import check_runnable, read_building
from zenostat.models.catalog import find_building
from zenostat.models.input_format.idf_reader import idf_version
from zenostat.models.upgrade.files import upgrade_file
from zenostat.topics.errors import InvalidConfig, ModelError, UnknownName

pytestmark = pytest.mark.skipif(not energyplus.version().startswith("25.2"), reason="the steps end at 25.2")

PROGRAM = """#!{python}
import pathlib, re, sys
before, after = {before!r}, {after!r}
assert pathlib.Path("V-Energy+.idd").exists()
model = pathlib.Path(sys.argv[1])
text = model.read_text()
print("Processing IDF -- Processing idf objects")
if {works}:
    model.with_suffix(".idfold").write_text(text)
    model.write_text(re.sub(rf"Version,\\s*{{re.escape(before)}}", f"Version,{{after}}", text))
"""


@pytest.fixture
def office() -> dict[str, dict[str, dict[str, object]]]:
    return dict(read_building(find_building("ref-small-office")).objects)


def transition_programs(folder: Path, *versions: str, works: bool = True) -> Path:
    """Write programs with the names and the manner of EnergyPlus's own; they change the version alone."""
    folder.mkdir()
    (folder / "V-Energy+.idd").write_text("")
    for before, after in pairwise(versions):
        names = [f"V{version.replace('.', '-')}-0" for version in (before, after)]
        program = folder / f"Transition-{names[0]}-to-{names[1]}"
        program.write_text(PROGRAM.format(python=sys.executable, before=before, after=after, works=works))
        program.chmod(0o755)
    return folder


def test_read_building__upgrades_and_says_so(office: dict[str, dict[str, dict[str, object]]], tmp_path: Path) -> None:
    path = tmp_path / "old.epJSON"
    path.write_text(json.dumps(taken_back(office, "9.0")))
    building = read_building(find_building(str(path)))
    check_runnable(building)
    (note,) = building.notes
    assert note.startswith("upgraded from EnergyPlus 9.0 to 25.2: ")
    assert building.file == str(path)


NAMES = {"Büro", "Voilà", "Ålesund", "会议室"}
"""Names with characters that Latin-1 has, with bytes that it takes for a blank or a line end, and that it lacks."""


def test_read_building__characters_of_an_earlier_version_are_kept(tmp_path: Path) -> None:
    pytest.importorskip("idfkit")
    path = tmp_path / "old.idf"
    zones = "\n".join(f"Zone,{name};" for name in NAMES)
    path.write_text(f"! Å, or; not\nVersion,22.2;\nBuilding,B;\n{zones}\n", encoding="utf-8")
    assert read_building(find_building(str(path))).objects["Zone"].keys() == NAMES
    programs = transition_programs(tmp_path / "programs", "22.2", "23.1")
    assert upgrade_file(path, programs).objects["Zone"].keys() == NAMES
    path.write_bytes(path.read_text(encoding="utf-8").encode("gb18030"))
    with pytest.raises(InvalidConfig, match="is not UTF-8: save the file as UTF-8"):
        upgrade_file(path)


@pytest.mark.parametrize("suffix", [".idf", ".epJSON"])
def test_read_building__dangling_reference_of_an_earlier_version_has_its_line(
    office: dict[str, dict[str, dict[str, object]]], suffix: str, tmp_path: Path
) -> None:
    name, fields = next(iter(office["Lights"].items()))
    office["Lights"] = {name: fields | {"schedule_name": "Nowhere"}}
    path = tmp_path / f"old{suffix}"
    old = json.dumps(taken_back(office, "9.2"), indent=1)
    path.write_text(as_idf(office, "9.2") if suffix == ".idf" else old)
    with pytest.raises(InvalidConfig) as raised:
        check_runnable(read_building(find_building(str(path))))
    line = next(i for i, text in enumerate(path.read_text().splitlines(), 1) if "Nowhere" in text)
    assert f"  line {line}: Lights {name!r}: schedule_name is 'Nowhere'" in str(raised.value)


def test_models_upgrade__writes_a_model_of_the_engines_version(
    office: dict[str, dict[str, dict[str, object]]], tmp_path: Path
) -> None:
    path, output = tmp_path / "old.epJSON", tmp_path / "new.epJSON"
    path.write_text(json.dumps(taken_back(office, "22.1")))
    result = run_in_process("models", "upgrade", str(path), "--output", str(output), columns=300)
    assert result.returncode == 0, result.stderr
    assert "watts_per_zone_floor_area is now watts_per_floor_area" in result.stdout
    assert "upgraded from EnergyPlus 22.1 to 25.2: " in result.stdout
    assert read_building(find_building(str(output))).notes == ()


def test_models_upgrade__writes_an_idf(office: dict[str, dict[str, dict[str, object]]], tmp_path: Path) -> None:
    path, output = tmp_path / "old.epJSON", tmp_path / "new.idf"
    path.write_text(json.dumps(taken_back(office, "24.1")))
    assert run_in_process("models", "upgrade", str(path), "--output", str(output)).returncode == 0
    assert idf_version(output.read_text()) == "25.2"
    assert read_building(find_building(str(output))).objects["Zone"] == office["Zone"]


def test_models_upgrade__idf_has_the_characters_of_the_model(tmp_path: Path) -> None:
    path, output = tmp_path / "old.epJSON", tmp_path / "new.idf"
    objects = {
        "Version": {"V": {"version_identifier": "24.1"}},
        "Building": {"B": {}},
        "Zone": {name: {} for name in NAMES},
    }
    path.write_text(json.dumps(objects))
    result = run_in_process("models", "upgrade", str(path), "--output", str(output))
    assert result.returncode == 0, result.stderr
    assert upgrade_file(output).objects["Zone"].keys() == NAMES


def test_models_upgrade__never_replaces_a_file(tmp_path: Path) -> None:
    path = tmp_path / "old.idf"
    path.write_text("Version,22.1;")
    result = run_in_process("models", "upgrade", str(path), "--output", str(path), columns=300)
    assert result.returncode != 0
    assert "exists already; choose another name" in result.stderr
    assert path.read_text() == "Version,22.1;"


def test_models_upgrade__lists_each_change_as_json(
    office: dict[str, dict[str, dict[str, object]]], tmp_path: Path
) -> None:
    path = tmp_path / "old.epJSON"
    path.write_text(json.dumps(taken_back(office, "23.2")))
    report = json.loads(run_in_process("models", "upgrade", str(path), "--json").stdout)
    assert (report["before"], report["after"]) == ("23.2", "25.2")
    lights = {change["name"] for change in report["changes"] if change["kind"] == "Lights"}
    assert lights == set(office["Lights"])


def test_upgrade_file__says_what_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match=r"there is no file /\S*/nothing\.idf"):
        upgrade_file(tmp_path / "nothing.idf")
    with pytest.raises(UnknownName, match="is a folder; expected a model file"):
        upgrade_file(tmp_path)
    (tmp_path / "model.txt").write_text("")
    with pytest.raises(InvalidConfig, match=r"its suffix should be \.epjson or \.idf"):
        upgrade_file(tmp_path / "model.txt")


def test_upgrade_file__transition_programs_go_first_and_the_rules_follow(
    office: dict[str, dict[str, dict[str, object]]], tmp_path: Path
) -> None:
    pytest.importorskip("idfkit")
    path = tmp_path / "old.idf"
    path.write_text(as_idf(office, "24.1"))
    programs = transition_programs(tmp_path / "programs", "23.2", "24.1", "24.2")
    upgraded = upgrade_file(path, programs)
    assert (upgraded.before, upgraded.after) == ("24.1", "25.2")
    assert [(change.before, change.after) for change in upgraded.changes] == [("24.1", "24.2")]
    assert idf_version(path.read_text()) == "24.1"
    assert upgraded.objects == upgrade_file(path).objects


def test_upgrade_file__failing_transition_program_is_named_with_its_output(tmp_path: Path) -> None:
    path = tmp_path / "old.idf"
    path.write_text("Version,8.9;")
    programs = transition_programs(tmp_path / "programs", "8.9", "9.0", works=False)
    with pytest.raises(ModelError) as raised:
        upgrade_file(path, programs)
    assert "Transition-V8-9-0-to-V9-0-0 could not upgrade" in str(raised.value)
    assert "left version 8.9\n  Processing IDF" in str(raised.value)


def test_upgrade_file__folder_without_programs_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "old.idf"
    path.write_text("Version,8.9;")
    with pytest.raises(InvalidConfig, match="has no transition programs"):
        upgrade_file(path, tmp_path)
    with pytest.raises(InvalidConfig, match=r"is for EnergyPlus 8\.9; .* has programs for 9\.0"):
        upgrade_file(path, transition_programs(tmp_path / "programs", "9.0", "9.1"))
