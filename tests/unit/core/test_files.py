"""Files that are written under a temporary name and moved."""

import os

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.files import replacing_file


@pytest.mark.parametrize(
    "error, raised", [(OSError(28, "No space left"), InputError), (KeyboardInterrupt(), KeyboardInterrupt)]
)
def test_a_new_file_that_cannot_be_moved_leaves_its_name_free(tmp_path, monkeypatch, error, raised):
    def fail(source, destination):
        raise error

    path = tmp_path / "leaf.blend"
    with monkeypatch.context() as patched, pytest.raises(raised):
        patched.setattr(os, "replace", fail)
        with replacing_file(path, new=True) as partial:
            partial.write_bytes(b"new")
    assert not list(tmp_path.iterdir())
    with replacing_file(path, new=True) as partial:
        partial.write_bytes(b"new")
    assert path.read_bytes() == b"new"


def test_a_file_of_others_stays_where_a_new_one_was_to_be(tmp_path):
    path = tmp_path / "leaf.blend"
    with pytest.raises(FileExistsError), replacing_file(path, new=True) as partial:
        partial.write_bytes(b"mine")
        path.write_bytes(b"theirs")
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("leaf.blend", b"theirs")]


def test_a_former_file_stays_where_it_cannot_be_replaced(tmp_path, monkeypatch):
    def fail(source, destination):
        raise OSError(28, "No space left")

    path = tmp_path / "leaf.blend"
    path.write_bytes(b"former")
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InputError, match="No space left"), replacing_file(path) as partial:
        partial.write_bytes(b"new")
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("leaf.blend", b"former")]
