"""The reason that a node names when EnergyPlus has ended."""

from pathlib import Path

from support.box_model import box_model

from zenostat.eplus_node.engine_spec import explain_end
from zenostat.models.building.model import Building


def test_explain_end__warnings_on_the_model_follow_the_messages(tmp_path: Path) -> None:
    model = box_model()
    model["Material"]["Concrete"]["thickness"] = 200.0
    (tmp_path / "eplusout.err").write_text("   **  Fatal  ** It ended\n")
    text = explain_end(Building("thick", model, "thick box"), tmp_path, "nothing")
    assert text.splitlines() == [
        "EnergyPlus reports:",
        "  ** Fatal ** It ended",
        "thick also has:",
        "  Material 'Concrete': thickness is 200 m; is it in mm?",
    ]


def test_explain_end__sound_model_has_the_fallback_alone(tmp_path: Path) -> None:
    assert explain_end(Building("box", box_model(), "box"), tmp_path, "nothing") == "nothing"
