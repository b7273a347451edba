"""The model of a result, found from its folder and from each of its files."""

import json

import pytest

from irpso_addon.exports.result import model_of_result

FILES = ["maps.1001.exr", "maps.1002.exr", "anisotropy.1001.exr", "anisotropy.1002.exr", "report.json"]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "report.json").write_text(json.dumps({"model": "anisotropic", "files": FILES}), encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("name", ["", "maps.1002.exr", "maps.<UDIM>.exr", "anisotropy.1001.exr"])
def test_files_of_a_result_have_its_model_as_its_folder_has(folder, name):
    assert model_of_result(folder / name).name == "anisotropic"


@pytest.mark.parametrize("name", ["normal_gt.exr", "maps.exr"])
def test_a_file_that_no_result_lists_has_no_model(folder, name):
    assert model_of_result(folder / name) is None


@pytest.mark.parametrize("text", ["[]", "{", '{"score": 3}'])
def test_a_file_beside_a_report_of_another_program_has_no_model(tmp_path, text):
    (tmp_path / "report.json").write_text(text, encoding="utf-8")
    assert model_of_result(tmp_path / "maps.exr") is None
