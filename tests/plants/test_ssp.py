"""SSP files as districts: what of them becomes which plant and connection, errors, and FMPy's own master beside it."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support import ssp_files as ssp
from support.fmus import build_tank
from support.run_cli import run_in_process, run_program

import zenostat  # noqa: F401  # registers the environments
from zenostat.cli.cosim_ssp import convert
from zenostat.cli.options import Loops
from zenostat.cosim.file import read_district
from zenostat.cosim.topology import check_file
from zenostat.plants.ssp import archive as ssp_archive
from zenostat.plants.ssp.structure import read_structure
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.yaml12 import dump, parse

pytest.importorskip("fmpy")


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tank as an FMU."""
    return build_tank(tmp_path_factory.mktemp("tank"))


def converted(folder: Path, tank: Path, root: str, loops: Loops = Loops.SOLVE, **options: Any) -> dict[str, Any]:
    """The content of the district's file that an SSP file becomes."""
    source = ssp.write_ssp(folder / "system.ssp", tank, root, **options)
    convert(source, folder / "district.yaml", loops, overwrite=False)
    return parse((folder / "district.yaml").read_text(), "the file")


def test_convert__nested_systems_become_plants_and_connections(tank: Path, tmp_path: Path) -> None:
    content = converted(tmp_path, tank, ssp.TWO_TANKS, files=ssp.VALUES)
    experiment = {"step_s": 60.0, "duration_s": 1200.0}
    assert content == {
        "name": "two_tanks",
        "about": "From system.ssp.",
        "timestep": 60.0,
        "plants": {
            "first": {"fmu": "district/tank.fmu", "plant_arguments": {**experiment, "set": {ssp.LOSS: 3.0}}},
            "sub_second_tank": {"fmu": "district/tank.fmu", "plant_arguments": {**experiment, "set": {ssp.LOSS: 4.0}}},
        },
        "connections": [
            {"from": "first.T", "to": "sub_second_tank.heat", "unit": "degC", "factor": -20.0, "offset": 2000.0},
            {"from": "sub_second_tank.power", "to": "first.heat", "factor": 0.5, "solve": True, "tolerance": 1e-3},
        ],
    }
    assert (tmp_path / "district" / "tank.fmu").read_bytes() == tank.read_bytes()


@pytest.mark.parametrize(
    ("stop_s", "duration_s", "note"),
    [
        (1000, 960.0, "1000 s are not a multiple of the step size 60 s; an episode has 960 s"),
        (40, 60.0, "40 s are not a multiple of the step size 60 s; an episode has 60 s"),
        (1020, 1020.0, ""),
    ],
)
def test_convert__episode_has_whole_timesteps(
    stop_s: float, duration_s: float, note: str, tank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = converted(tmp_path, tank, ssp.TWO_TANKS, files=ssp.VALUES, stop_s=stop_s)
    assert {plant["plant_arguments"]["duration_s"] for plant in content["plants"].values()} == {duration_s}
    printed = " ".join(capsys.readouterr().err.split())
    assert (note in printed) if note else ("multiple" not in printed)


def test_convert__step_size_that_the_file_does_not_name_is_an_option(
    tank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = converted(tmp_path, tank, ssp.TWO_TANKS, files=ssp.VALUES, step_s=None)
    assert "timestep" not in content
    assert "the SSP file names no step size" in " ".join(capsys.readouterr().err.split())
    source, target = tmp_path / "system.ssp", tmp_path / "district.yaml"
    convert(source, target, Loops.SOLVE, overwrite=True, step_s=30.0)
    content = parse(target.read_text(), "the file")
    assert content["timestep"] == 30.0
    assert {plant["plant_arguments"]["step_s"] for plant in content["plants"].values()} == {30.0}
    assert "names no step size" not in " ".join(capsys.readouterr().err.split())
    with pytest.raises(InvalidConfig, match="--step 0: a number of seconds above 0 expected"):
        convert(source, target, Loops.SOLVE, overwrite=True, step_s=0.0)


SUPPRESSED = 'suppressUnitConversion="true"'


@pytest.mark.parametrize(
    ("unit", "outer", "inner", "factor", "offset"),
    [
        ("kW", "", "", 1.0, 250.0),  # 2 (1000 (0.5 x / 1000 + 0.1)) + 50
        ("kW", SUPPRESSED, "", 1000.0, 250.0),  # 2 (1000 (0.5 x + 0.1)) + 50
        ("kW", "", SUPPRESSED, 1e-3, 50.2),  # 2 (0.5 x / 1000 + 0.1) + 50
        ("kW", SUPPRESSED, SUPPRESSED, 1.0, 50.2),  # 2 (0.5 x + 0.1) + 50
        ("", "", "", 1.0, 50.2),
        ("W", "", "", 1.0, 50.2),
    ],
)
def test_convert__each_connection_converts_before_it_transforms(
    unit: str, outer: str, inner: str, factor: float, offset: float, tank: Path, tmp_path: Path
) -> None:
    nested = ssp.system(
        "sub", ssp.component("b"), ssp.connection(":q", "b:heat", ssp.linear(2.0, 50.0), inner),
        ssp.connector("q", "input", unit),
    )  # fmt: skip
    link = ssp.connection("a:power", "sub:q", ssp.linear(0.5, 0.1), outer)
    (connection,) = converted(tmp_path, tank, ssp.system("s", ssp.component("a") + nested, link))["connections"]
    assert connection.get("factor", 1.0) == pytest.approx(factor)
    assert connection.get("offset", 0.0) == pytest.approx(offset)
    assert "unit" not in connection


def test_convert__temperatures_through_kelvin(tank: Path, tmp_path: Path) -> None:
    """20 degC is 293.15 K, of which 0.9 is -9.315 degC, of which 1.1 is -10.2465."""
    celsius = [ssp.connector("heat", "input", "degC"), ssp.connector("T", "output"), ssp.connector("power", "output")]
    nested = ssp.system(
        "sub", ssp.component("a"), ssp.connection("a:T", ":T", ssp.linear(0.9)), ssp.connector("T", "output", "K")
    )
    link = ssp.connection("sub:T", "b:heat", ssp.linear(1.1))
    root = ssp.system("s", nested + ssp.component("b", connectors="".join(celsius)), link)
    (connection,) = converted(tmp_path, tank, root)["connections"]
    assert connection["unit"] == "degC"  # as the FMU's input is in W
    assert connection["factor"] * 20.0 + connection["offset"] == pytest.approx(-10.2465)


UNITS = ssp.units(
    "ssd", deg='rad="1" factor="0.017453292519943295"', rad='rad="1"',
    km_per_h='m="1" s="-1" factor="0.2777777777777778"',
    m_per_s='m="1" s="-1"', mW='kg="1" m="2" s="-3" factor="0.001"', W='kg="1" m="2" s="-3"',
    degF='K="1" factor="0.5555555555555556" offset="255.3722222222222"', K='K="1"', Mm='m="1" factor="1e6"',
)  # fmt: skip


def driven(source: str, target: str, attributes: str = "") -> str:
    """A system in which a tank's output with a unit drives another one's input with a unit."""
    a = ssp.component("a", connectors=ssp.connector("power", "output", source))
    b = ssp.component("b", connectors=ssp.connector("heat", "input", target))
    return ssp.system("s", a + b, ssp.connection("a:power", "b:heat", ssp.linear(2.0, 1.0), attributes))


@pytest.mark.parametrize(
    ("source", "target", "factor", "offset"),
    [
        ("deg", "rad", 2.0 * np.pi / 180.0, 1.0),
        ("km/h", "m/s", 2.0 / 3.6, 1.0),
        ("mW", "W", 2e-3, 1.0),
        ("W", "mW", 2e3, 1.0),
        ("degF", "K", 2.0 / 1.8, 1.0 + 2.0 * 459.67 / 1.8),
        ("Mm", "Mm", 2.0, 1.0),
        ("rpm", "rpm", 2.0, 1.0),
        ("%", "fraction", 2e-2, 1.0),  # not in the file, but known
        ("-", "rad", 2.0, 1.0),
    ],
)
def test_convert__units_are_converted_by_their_definitions(
    source: str, target: str, factor: float, offset: float, tank: Path, tmp_path: Path
) -> None:
    (connection,) = converted(tmp_path, tank, driven(source, target), units=UNITS)["connections"]
    assert connection["factor"] == pytest.approx(factor, rel=1e-12)
    assert connection["offset"] == pytest.approx(offset, rel=1e-12)


@pytest.mark.parametrize(("source", "target"), [("deg", "m/s"), ("rpm", "rad"), ("kW", "K"), ("W", "furlong")])
def test_convert__units_that_are_unlike_or_not_defined_are_refused(
    source: str, target: str, tank: Path, tmp_path: Path
) -> None:
    with pytest.raises(InvalidConfig, match=rf"line 3: {source} is not converted to {target}: they are unlike"):
        converted(tmp_path, tank, driven(source, target), units=UNITS)
    (connection,) = converted(tmp_path, tank, driven(source, target, SUPPRESSED), units=UNITS)["connections"]
    assert (connection["factor"], connection["offset"]) == (2.0, 1.0)


def test_convert__units_of_an_fmu_are_converted_by_its_own_definitions(tank: Path, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    with zipfile.ZipFile(tank) as source, zipfile.ZipFile(own / "tank.fmu", "w") as target:
        for name in source.namelist():
            text = source.read(name)
            for unit, base in (("K/s", 'K="1" s="-1"'), ("W/K", 'kg="1" m="2" s="-3" K="-1" factor="1000"')):
                defined = f'<Unit name="{unit}"><BaseUnit {base}/></Unit>'.encode()
                text = text.replace(f'<Unit name="{unit}"/>'.encode(), defined)
            target.writestr(name, text)
    units = ssp.units("ssv", small='kg="1" m="2" s="-3" K="-1"')
    values = ssp.parameter_set(ssp.real(ssp.LOSS, 3000.0, "small"), units=units)
    root = ssp.system("s", ssp.component("a", ssp.bindings(ssp.inline(values))))
    content = converted(tmp_path, own / "tank.fmu", root)
    assert content["plants"]["a"]["plant_arguments"]["set"] == {ssp.LOSS: pytest.approx(3.0)}


def test_convert__mapped_parameters_are_converted_before_they_are_transformed(tank: Path, tmp_path: Path) -> None:
    """50 degF are 10 degC, of which 2 T - 3 is 17; 2 * 50 - 3 would be 36.1 degC."""
    mapping = ssp.mapping(f'<ssm:MappingEntry source="k" target="a.T">{ssp.linear(2.0, -3.0)}</ssm:MappingEntry>')
    values = ssp.parameter_set(ssp.real("k", 50.0, "degF"))
    root = ssp.system("s", A, inside=ssp.bindings(ssp.inline(values, mapping=mapping)))
    assert converted(tmp_path, tank, root)["plants"]["a"]["plant_arguments"]["set"] == {"T": pytest.approx(17.0)}


def test_convert__connection_of_long_names_has_a_short_one(tank: Path, tmp_path: Path) -> None:
    first, second = "a" * 50, "b" * 50
    links = ssp.connection(f"{first}:power", f"{second}:heat") + ssp.connection("c:power", f"{first}:heat")
    elements = "".join(ssp.component(name) for name in (first, second, "c"))
    content = converted(tmp_path, tank, ssp.system("s", elements, links))
    names = {connection["from"]: connection.get("name") for connection in content["connections"]}
    assert names == {f"{first}.power": "connection_1", "c.power": None}
    check_file(read_district(tmp_path / "district.yaml"))


def test_convert__loops_are_delayed_on_request(tank: Path, tmp_path: Path) -> None:
    content = converted(tmp_path, tank, ssp.TWO_TANKS, Loops.DELAY, files=ssp.VALUES)
    assert [each.get("delay") for each in content["connections"]] == [None, 1]


def test_convert__outer_parameters_replace_inner_ones_and_are_mapped(tank: Path, tmp_path: Path) -> None:
    entry = f'<ssm:MappingEntry source="k" target="b.{ssp.LOSS}">{ssp.linear(2.0, 1.0)}</ssm:MappingEntry>'
    mapping = ssp.mapping(entry)
    values = ssp.parameter_set(ssp.real("k", 3.0), ssp.real(f"b.{ssp.LOSS}", 9.0))
    inner = ssp.bindings(ssp.inline(ssp.parameter_set(ssp.real(ssp.LOSS, 5.0))))
    root = ssp.system(
        "s",
        ssp.component("a", inner) + ssp.component("b", inner),
        inside=ssp.bindings(ssp.inline(values, mapping=mapping)),
    )
    plants = converted(tmp_path, tank, root)["plants"]
    assert [plants[name]["plant_arguments"]["set"] for name in "ab"] == [{ssp.LOSS: 5.0}, {ssp.LOSS: 7.0}]


def test_convert__mapping_of_a_parameter_that_is_missing_is_noted(
    tank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = ssp.parameter_set(ssp.real("losses", 3.0))
    mapping = ssp.mapping(f'<ssm:MappingEntry source="loses" target="{ssp.LOSS}"/>')
    root = ssp.system("s", ssp.component("a", ssp.bindings(ssp.inline(values, mapping=mapping))))
    assert "set" not in converted(tmp_path, tank, root)["plants"]["a"]["plant_arguments"]
    error = capsys.readouterr().err
    assert f"SystemStructure.ssd line 3: a.{ssp.LOSS} is not set, as there is no parameter 'loses'" in error
    assert "did you mean 'losses'" in error


def test_convert__inputs_of_the_system_remain_actuators(
    tank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = ssp.system(
        "s", ssp.component("a"), ssp.connection(":power_in", "a:heat"), ssp.connector("power_in", "input")
    )
    assert "connections" not in converted(tmp_path, tank, root)
    assert "the system's input 'power_in' is not connected: command a.heat instead" in capsys.readouterr().err


A, B = ssp.component("a"), ssp.component("b")
CASES = {
    "not XML": ("<", "not XML"),
    "no such connector": (
        ssp.system("s", A + B, ssp.connection("a:T", "b:heet")),
        "line 3: element 'b' has no connector 'heet'; did you mean 'heat'"),
    "two outputs": (ssp.system("s", A + B, ssp.connection("a:T", "b:T")), "'T' and 'T' are both sources"),
    "two sources": (
        ssp.system("s", A + B, ssp.connection("a:T", "b:heat") + ssp.connection("a:power", "b:heat")),
        "b.heat has another connection already"),
    "no variable": (
        ssp.system("s", A + ssp.component("b", connectors=ssp.connector("warmth", "input")),
                   ssp.connection("a:T", "b:warmth")),
        "the FMU of 'b' has no scalar input or output 'warmth'"),
    "circle without a component": (
        ssp.system("s", A + ssp.system(
            "n", B, ssp.connection(":i", ":o"), ssp.connector("i", "input") + ssp.connector("o", "output")),
            ssp.connection("n:o", "n:i") + ssp.connection("n:o", "a:heat")),
        "n.o is driven by itself, through systems without a component"),
    "not in the schema": (ssp.system("s", '<ssd:Component name="a"/>'), "The attribute 'source' is required"),
    "not linear": (
        ssp.system("s", A + B, ssp.connection("a:T", "b:heat", '<ssc:BooleanMappingTransformation>'
                   '<ssc:MapEntry source="true" target="false"/></ssc:BooleanMappingTransformation>')),
        "BooleanMappingTransformation is not supported"),
    "no FMU": (
        ssp.system("s", ssp.component("a", attributes='type="application/x-ssp-package"')), "an FMU expected"),
    "outside of the file": (
        ssp.system("s", A.replace("resources/tank.fmu", "../tank.fmu")),
        "has no '../tank.fmu'; an SSP file contains all"),
    "encoded path outside of the file": (
        ssp.system("s", A.replace("resources/tank.fmu", "%2e%2e%2Ftank.fmu")),
        "has no '%2e%2e%2Ftank.fmu'; an SSP file contains all"),
    "unknown parameter": (
        ssp.system("s", ssp.component("a", ssp.bindings(ssp.inline(ssp.parameter_set(ssp.real("loss", 1.0)))))),
        "a: set: the FMU has no variable 'loss'"),
    "out of bounds": (
        ssp.system("s", ssp.component("a", ssp.bindings(ssp.inline(ssp.parameter_set(ssp.real(ssp.LOSS, 0.0)))))),
        "out of bounds; at least 0.5"),
    "other unit": (
        ssp.system("s", ssp.component(
            "a", ssp.bindings(ssp.inline(ssp.parameter_set(ssp.real(ssp.LOSS, 1.0, "bar")))))),
        f"{ssp.LOSS} is in bar; the FMU has it in W/K"),
    "no document": (
        ssp.system("s", A, inside=ssp.bindings('<ssd:ParameterBinding source="values.ssv"/>')), "has no 'values.ssv'"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_convert__what_cannot_be_used_is_one_error_and_writes_nothing(case: str, tank: Path, tmp_path: Path) -> None:
    root, words = CASES[case]
    with pytest.raises(InvalidConfig) as raised:
        converted(tmp_path, tank, root)
    assert words in str(raised.value)
    assert "system.ssp" in str(raised.value) or case in ("unknown parameter", "out of bounds", "other unit")
    assert [path.name for path in tmp_path.iterdir()] == ["system.ssp"]


def test_convert__document_type_does_not_read_files(tank: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("secret text")
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, ssp.system("&x;", A))
    with zipfile.ZipFile(source) as archive:
        text, fmu = archive.read("SystemStructure.ssd").decode(), archive.read("resources/tank.fmu")
    declared = text.replace("?>\n", f'?>\n<!DOCTYPE d [<!ENTITY x SYSTEM "file://{secret}">]>\n', 1)
    with zipfile.ZipFile(source, "w") as archive:
        archive.writestr("SystemStructure.ssd", declared)
        archive.writestr("resources/tank.fmu", fmu)
    done = run_in_process("cosim", "--from", str(source), str(tmp_path / "district.yaml"))
    written = "".join(path.read_text() for path in tmp_path.glob("*.yaml"))
    assert "secret text" not in written + done.stdout + done.stderr


def test_convert__existing_file_is_not_replaced_unasked(tank: Path, tmp_path: Path) -> None:
    (tmp_path / "district.yaml").write_text("mine")
    with pytest.raises(InvalidConfig, match=r"district\.yaml exists; choose another name, or --overwrite"):
        converted(tmp_path, tank, ssp.TWO_TANKS, files=ssp.VALUES)
    assert (tmp_path / "district.yaml").read_text() == "mine"


def test_convert__only_folders_of_earlier_conversions_are_replaced(tank: Path, tmp_path: Path) -> None:
    source, target = ssp.write_ssp(tmp_path / "system.ssp", tank, ssp.system("s", A)), tmp_path / "results.yaml"
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "measured.csv").write_text("mine")
    with pytest.raises(InvalidConfig, match=r"not of an earlier conversion \(it has measured\.csv\)"):
        convert(source, target, Loops.SOLVE, overwrite=True)
    (folder / "measured.csv").rename(folder / "mine.fmu")
    with pytest.raises(InvalidConfig, match=r"there is no results\.yaml beside it"):
        convert(source, target, Loops.SOLVE, overwrite=True)
    assert (folder / "mine.fmu").read_text() == "mine"
    (folder / "mine.fmu").unlink()
    folder.rmdir()
    for _ in range(2):
        convert(source, target, Loops.SOLVE, overwrite=True)
    assert [path.name for path in folder.iterdir()] == ["tank.fmu"]


def test_convert__different_fmus_with_similar_paths_have_a_copy_each(tank: Path, tmp_path: Path) -> None:
    elements = A + ssp.component("b").replace("resources/tank.fmu", "tank.fmu") + ssp.component("c")
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, ssp.system("s", elements))
    with zipfile.ZipFile(source, "a") as archive:
        archive.write(tank, "tank.fmu")
    convert(source, tmp_path / "district.yaml", Loops.SOLVE, overwrite=False)
    plants = parse((tmp_path / "district.yaml").read_text(), "the file")["plants"]
    assert {name: plant["fmu"] for name, plant in plants.items()} == {
        "a": "district/tank.fmu", "b": "district/2_tank.fmu", "c": "district/tank.fmu"
    }  # fmt: skip


def test_convert__fmu_with_a_long_name_has_a_shorter_copy(tank: Path, tmp_path: Path) -> None:
    name = f"{'t' * 300}.fmu"
    elements = A.replace("resources/tank.fmu", f"resources/{name}")
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, ssp.system("s", elements))
    with zipfile.ZipFile(source, "a") as archive:
        archive.write(tank, f"resources/{name}")
    convert(source, tmp_path / "district.yaml", Loops.SOLVE, overwrite=False)
    (copy,) = (tmp_path / "district").iterdir()
    assert (copy.suffix, len(copy.name), copy.read_bytes()) == (".fmu", 100, tank.read_bytes())


def test_convert__fmu_that_is_too_large_is_not_unpacked(
    tank: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, ssp.system("s", A))
    monkeypatch.setattr(ssp_archive, "MAX_BYTES", 1000)
    with pytest.raises(InvalidConfig, match=r"resources/tank.fmu would take [\d,]+ bytes; at most 1,000 are allowed"):
        convert(source, tmp_path / "district.yaml", Loops.SOLVE, overwrite=False)
    assert not (tmp_path / "district.yaml").exists()


@pytest.mark.parametrize(
    ("place", "value", "text"),
    [
        (8, 1, "resources/tank.fmu cannot be read: File 'resources/tank.fmu' is encrypted"),
        (10, 99, "resources/tank.fmu cannot be read: That compression method is not supported"),
        (16, None, "resources/tank.fmu cannot be read: Bad CRC-32"),
    ],
)
def test_convert__entry_that_cannot_be_read_is_named(
    place: int, value: int | None, text: str, tank: Path, tmp_path: Path
) -> None:
    """Flags, compression and checksum are at these places of the central directory, whose last entry is the FMU."""
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, ssp.system("s", A))
    content = bytearray(source.read_bytes())
    index = content.rindex(b"PK\x01\x02") + place
    content[index] = content[index] ^ 0xFF if value is None else value
    source.write_bytes(content)
    with pytest.raises(InvalidConfig, match=text):
        convert(source, tmp_path / "district.yaml", Loops.SOLVE, overwrite=False)


def test_convert__fmu_that_is_none_is_named_by_its_source(tmp_path: Path) -> None:
    (tmp_path / "tank.fmu").write_bytes(b"no archive")
    source = ssp.write_ssp(tmp_path / "system.ssp", tmp_path / "tank.fmu", ssp.system("s", A))
    with pytest.raises(InvalidConfig, match=r"system\.ssp: SystemStructure\.ssd: line \d+: resources/tank\.fmu "):
        convert(source, tmp_path / "district.yaml", Loops.SOLVE, overwrite=False)


def two_with_an_overwrite_block(*targets: str) -> str:
    """Two tanks, of which the first is connected to the overwrite block of the second."""
    connectors = "".join(ssp.connector(name, "input") for name in ("extra_u", "extra_activate"))
    elements = A + ssp.component("b", connectors=connectors)
    return ssp.system("s", elements, "".join(ssp.connection("a:power", f"b:{target}") for target in targets))


def test_convert__connected_overwrite_block_is_activated_and_noted(tank: Path, tmp_path: Path) -> None:
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, two_with_an_overwrite_block("extra_u"))
    (note,) = [note for note in read_structure(source, tmp_path / "fmus").notes if "extra" in note]
    assert note == (
        "the connection to 'extra_u' of 'b' also sets 'extra_activate' to true: an overwrite block acts while its "
        "value is commanded"
    )


def test_convert__activation_cannot_be_connected(tank: Path, tmp_path: Path) -> None:
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, two_with_an_overwrite_block("extra_u", "extra_activate"))
    with pytest.raises(InvalidConfig, match="'extra_activate' of 'b' cannot be connected: it is true while 'extra_u'"):
        convert(source, tmp_path / "district.yaml", Loops.SOLVE, overwrite=False)


@pytest.mark.parametrize("entry", ["my tänk.fmu", "my%20t%C3%A4nk.fmu"])
def test_convert__source_is_a_uri(entry: str, tank: Path, tmp_path: Path) -> None:
    elements = A.replace("resources/tank.fmu", "resources/my%20t%C3%A4nk.fmu")
    source = ssp.write_ssp(tmp_path / "system.ssp", tank, ssp.system("s", elements))
    with zipfile.ZipFile(source, "a") as archive:
        archive.write(tank, f"resources/{entry}")
    convert(source, tmp_path / "district.yaml", Loops.SOLVE, overwrite=False)
    assert [path.name for path in (tmp_path / "district").iterdir()] == [entry]


@pytest.mark.slow
@pytest.mark.process
def test_converted_district__runs_by_the_command(tank: Path, scratch: Path) -> None:
    ssp.write_ssp(scratch / "system.ssp", tank, ssp.TWO_TANKS, files=ssp.VALUES)
    run_program("cosim", "--from", str(scratch / "system.ssp"), str(scratch / "district.yaml"))
    done = run_program("cosim", str(scratch / "district.yaml"), "--once")
    assert "first.T-sub_second_tank.heat" in done.stdout


@pytest.mark.slow
@pytest.mark.process
def test_converted_district__equals_fmpys_own_master_to_the_bit(tank: Path, scratch: Path) -> None:
    """FMPy passes all values on after a step, and begins with zeros; the same delays give the same trajectory."""
    import fmpy.ssp.simulation
    import fmpy.ssp.ssd

    root = ssp.system(
        "Plant", A + B, ssp.connection("a:T", "b:heat", attributes='suppressUnitConversion="true"')
        + ssp.connection("b:power", "a:heat")
    )  # fmt: skip
    content = converted(scratch, tank, root, Loops.DELAY)
    path = scratch / "district.yaml"
    for entry in content["connections"]:
        entry |= {"delay": 1, "initial": 0.0}
    path.write_text(dump(content), encoding="utf-8")
    expected = fmpy.ssp.simulation.simulate_ssp(str(scratch / "system.ssp"), stop_time=1200.0, step_size=60.0)
    with gym.make("zenostat/District-v1", file=path, reward=None) as created:
        env = created.unwrapped
        env.reset(seed=1)
        rows = []
        own = {"a.extra": 50.0, "b.extra": 50.0, "a.mode": 1.0, "b.mode": 1.0}  # what the tanks do without a command
        idle = np.array([own.get(point.name, 0.0) for point in env.manifest.actuators], np.float32)
        for _ in range(20):
            env.step(idle)
            rows.append([env.sample[name] for name in ("a.T", "b.T", "a.power", "b.power")])
    columns = [expected[f"{name}"] for name in ("a.T", "b.T", "a.power", "b.power")]
    assert np.array(rows).T.tolist() == [column.tolist() for column in columns]
