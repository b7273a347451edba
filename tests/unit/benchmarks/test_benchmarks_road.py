"""The page of the road from photographs to a material."""

from benchmarks import road


def test_a_road_without_its_photographs_is_skipped_in_one_line():
    step = {"step": "Recover", "clicks": 1, "seconds": 2.0, "turn": 0.1, "said": []}
    roads = {
        "rig": {"load": 0.5, "steps": [step], "texels": 0},
        "icon": {"skipped": "rti_icon is not in the folder of test data"},
    }
    data = {"blender": "trixie", "backend": "opengl", "roads": roads}
    lines = road.write(data, None)
    assert lines[-1] == "Skipped: rti_icon is not in the folder of test data."
    assert "Load of the machine before: 0.5." in lines  # no texels were recovered
    assert road.headline(data) == "rig: 1 clicks, 2 s"
