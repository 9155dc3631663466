"""A district's file: each mistake is one sentence with its line, before anything starts."""

import json
from pathlib import Path

import jsonschema
import pytest
from support.coupled_plants import district_file

from zenostat.cosim.file import json_schema
from zenostat.cosim.topology import Block, check_file
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig

PLANTS = """plants:
  a: {plant: "plants.py:A"}
  b: {plant: "plants.py:B"}
  c: {plant: "plants.py:C"}
connections:
"""
"""Connections begin in line 6."""


def errors_of(folder: Path, text: str) -> str:
    with pytest.raises(InvalidConfig) as caught:
        check_file(district_file(folder, text))
    return str(caught.value).replace(str(folder / "district.yaml"), "FILE")


def test_read_district__file_of_another_kind_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfig, match=r"district.yaml is a scenario file, not a district file: .*evaluate"):
        district_file(tmp_path, "building: SmallOffice\nweather: chicago\ncontrol: zone\n")


@pytest.mark.parametrize(
    ("connections", "expected"),
    [
        ("  - {from: a.x, to: d.u}", "FILE:6: d.u: no plant 'd'; there are: 'a', 'b', 'c'"),
        (
            "  - {from: a.x, to: b.u}\n  - {from: c.x, to: b.u}",
            "FILE:7: b.u has a source in line 6 already; `sum: true` in both adds their values",
        ),
        (
            "  - {from: a.x, to: b.u, sum: true}\n  - {from: c.x, to: b.u}",
            "FILE:7: b.u has a source in line 6 already; `sum: true` in both adds their values",
        ),
        (
            "  - {from: a.x, to: b.u}\n  - {from: b.x, to: c.u}\n  - {from: c.x, to: a.u}",
            "FILE:6: a loop without delay or solution (lines 6 and 7 and 8): a.x → b.u, b.x → c.u, c.x → a.u; give one "
            "of them `delay: 1`, or `solve: true` with a `tolerance`",
        ),
        (
            "  - {from: c.x, to: c.u}",
            "FILE:6: a loop without delay or solution (line 6): c.x → c.u; give one of them `delay: 1`, or "
            "`solve: true` with a `tolerance`",
        ),
        (
            "  - {from: a.x, to: b.u, solve: true, tolerance: 0.1}",
            "FILE:6: this connection is part of no loop; leave out `solve`",
        ),
        (
            "  - {from: a.x, to: a.u, solve: true}",
            "FILE:6: a solved connection needs its greatest residual in the target's unit: `tolerance: 0.01`",
        ),
        (
            "  - {from: a.x, to: a.u, solve: true, tolerance: 1, delay: 2}",
            "FILE:6: a connection is delayed or solved, not both; leave out `delay` or `solve`",
        ),
        (
            "  - from: a.x\n    to: b.u\n    tolerance: 0.1",
            "FILE:8: only a solved connection has a tolerance; add `solve: true`, or leave it out",
        ),
        (
            "  - {from: a.x, to: b.u}\n  - from: a.x\n    to: b.v\n    inital: 3",
            "FILE:9: connections.1.inital: there is no such field; did you mean 'initial'",
        ),
        ("  - {from: a.x}", "FILE:6: connections.0.to: it is missing"),
        ("  - {from: a, to: b.u}", "FILE:6: connections.0.from: "),
        ("  - {from: a.x, to: b.u, delay: 0}", "FILE:6: connections.0.delay: "),
        ("  - {from: a.x, to: b.u, low: 2, high: 1}", "FILE:6: low 2 is not below high 1"),
        (
            "  - {from: a.x, to: b.u, name: one}\n  - {from: a.x, to: c.u, name: one}",
            "FILE:7: line 6 has a connection of the same name 'one'; give it another `name`",
        ),
    ],
)
def test_file__each_mistake_of_a_connection_has_its_line(folder: Path, connections: str, expected: str) -> None:
    assert errors_of(folder, PLANTS + connections + "\n").startswith(expected)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "name: town\nplants:\n  a: {building: ref-small-office, plant: 'a.py:A'}\n",
            "FILE:3: plant 'a' is building and plant at once; expected one of",
        ),
        (f"name: {'t' * 127}\nplants:\n  a: {{plant: tank.py}}\n", "FILE:3: plant 'a': its node would be named"),
        ("name: town\nplants:\n  a: {begin: 07-03}\n", "FILE:3: plant 'a' says not what it is; expected one of"),
        ("plants:\n  loop: {plant: 'a.py:A'}\n", "FILE:2: a plant cannot have the name 'loop'"),
        ("plants:\n  a.b: {plant: 'a.py:A'}\n", "FILE:2: "),
        ("plants:\n  a: {node: office}\n", "FILE:2: plant 'a': `node` and `connect` belong together"),
        (
            "plants:\n  a: {node: office, connect: tcp/127.0.0.1:7447, begin: 07-03}\n",
            "FILE:2: plant 'a' runs already, with settings of its own; leave out begin",
        ),
        ("timestep: 15 minutes\nplants:\n  a: {plant: 'a.py:A'}\n", "FILE:1: timestep"),
        (
            "plants:\n  a:\n    plant: 'a.py:A'\n    keys: x\n",
            "FILE:4: plant 'a' is started on a bus of its own, without keys; leave them out",
        ),
        ("plants: {}\n", "FILE:1: plants: "),
        ("plants:\n  a: {plant: 'a.py:A', bilding: x}\n", "FILE:2: plants.a.bilding: there is no such field"),
        (
            "name: town\nplants:\n  a: {node: town, connect: tcp/127.0.0.1:7447}\n",
            "FILE:3: the start is circular: plant 'a' is the node 'town', which is the name of this district",
        ),
    ],
)
def test_file__each_mistake_of_a_plant_has_its_line(folder: Path, text: str, expected: str) -> None:
    assert errors_of(folder, text).startswith(expected)


def test_file__all_errors_are_listed_in_the_order_of_their_lines(folder: Path) -> None:
    text = errors_of(folder, PLANTS + "  - {from: a.x, to: d.u}\n  - {from: e.x, to: b.u}\n")
    assert [line.strip().split(": ")[0] for line in text.splitlines()] == ["FILE has errors:", "FILE:6", "FILE:7"]


def test_file__district_that_starts_itself_is_circular(folder: Path) -> None:
    (folder / "inner.yaml").write_text("plants:\n  outer: {district: district.yaml}\n")
    text = errors_of(folder, "plants:\n  inner:\n    district: inner.yaml\n")
    assert text == "FILE:3: the start is circular: district.yaml starts inner.yaml starts district.yaml"


def test_file__order_of_a_step_follows_the_connections(folder: Path) -> None:
    text = """  - {from: c.x, to: b.u}
  - {from: b.x, to: a.u}
  - {from: a.x, to: c.u, delay: 1}
"""
    topology = check_file(district_file(folder, PLANTS + text))
    assert topology.groups == ((Block((("c",),)),), (Block((("b",),)),), (Block((("a",),)),))
    assert topology.loops == ()


def test_file__plants_without_connection_step_side_by_side(folder: Path) -> None:
    topology = check_file(district_file(folder, PLANTS.replace("connections:\n", "")))
    assert topology.groups == ((Block((("a",),)), Block((("b",),)), Block((("c",),))),)


def test_file__solved_loop_is_one_block_in_the_order_of_a_trial(folder: Path) -> None:
    text = """  - {from: b.x, to: a.u}
  - {from: a.x, to: b.u, solve: true, tolerance: 0.1}
  - {from: a.x, to: c.u}
"""
    topology = check_file(district_file(folder, PLANTS + text))
    assert topology.groups == ((Block((("b",), ("a",)), (1,), "a-b"),), (Block((("c",),)),))


def test_file__loops_have_names_of_their_own(folder: Path) -> None:
    """Plants may have hyphens, so names of several may be equal when joined."""
    text = "plants:\n" + "".join(f"  {name}: {{plant: 'p.py:P'}}\n" for name in ("a-b", "c", "a", "b-c"))
    text += "connections:\n"
    for one, back in (("a-b", "c"), ("a", "b-c")):
        text += f"  - {{from: {one}.x, to: {back}.u}}\n"
        text += f"  - {{from: {back}.x, to: {one}.u, solve: true, tolerance: 0.1}}\n"
    assert sorted(block.name for block in check_file(district_file(folder, text)).loops) == ["a-b-c", "a-b-c-2"]


def test_schema__accepts_what_the_file_accepts() -> None:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    text = PLANTS + "  - {from: a.x, to: b.u, sum: true, delay: 1}\n"
    jsonschema.validate(yaml12.parse(text, "text"), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(yaml12.parse(text.replace("delay", "delays"), "text"), schema)
    assert "Kind of the reward" not in json.dumps(schema)


def test_yaml_lines__each_value_has_its_line() -> None:
    text = "a: 1\nb:\n  - x\n  - c: 2\n    d: [3,\n        4]\nbase: &base\n  e: 5\nmerged:\n  <<: *base\n  f: 6\n"
    _, lines = yaml12.parse_with_lines(text, "text")
    expected = {
        ("a",): 1, ("b", 0): 3, ("b", 1, "c"): 4, ("b", 1, "d", 1): 6, ("merged", "e"): 8, ("merged", "f"): 11,
    }  # fmt: skip
    assert {path: lines[path] for path in expected} == expected
    assert lines.at(("b", 1, "unknown", 7)) == 4
    assert lines.at(("unknown",)) == 1


@pytest.mark.parametrize(
    ("timestep", "error"),
    [
        ("0", "Input should be greater than 0, got 0"),
        ("[1]", "Input should be a valid number"),
        ("1.0e-7", "a whole number of microseconds expected, at least 1"),
        ("0.33333333333", "a whole number of microseconds expected, at least 1"),
    ],
)
def test_file__duration_has_one_error(folder: Path, timestep: str, error: str) -> None:
    text = f"timestep: {timestep}\nplants:\n  a: {{plant: 'p.py:P'}}\n"
    with pytest.raises(InvalidConfig) as caught:
        district_file(folder, text)
    assert str(caught.value).count("timestep") == 1
    assert f"timestep: {error}" in str(caught.value)
