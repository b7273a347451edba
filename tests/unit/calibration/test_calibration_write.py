"""A calibration's files beside OUT.toml: where one cannot be written, no new one is left."""

import errno
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.calibration import write
from irpso_addon.core.errors import InputError

PICTURE = np.zeros((4, 6, 3))


def written(out):
    write._write(out, lambda folder: "format = 1\n", {}, False, picture=PICTURE)


def test_a_table_is_written_with_its_report_and_picture(tmp_path):
    written(tmp_path / "new.toml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new.toml", "new_balls.png", "new_report.json"]


@pytest.mark.parametrize("obstacle", ["new.toml", "new_report.json", "new_balls.png"])
def test_where_one_file_cannot_be_written_the_others_are_not_left(obstacle, tmp_path):
    (tmp_path / obstacle).mkdir()  # no file replaces a folder
    with pytest.raises(InputError, match=r"new.toml: cannot be written \(.*\); choose another place"):
        written(tmp_path / "new.toml")
    assert [p.name for p in tmp_path.iterdir()] == [obstacle]


def test_a_full_disk_leaves_former_files_and_is_told_of_the_table(tmp_path, monkeypatch):
    former = [tmp_path / name for name in ("new.toml", "new_balls.png", "new_report.json")]
    for path in former:
        path.write_text("former")

    def full(path, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"new\.toml: cannot be written \(No space left on device\)"):
        written(tmp_path / "new.toml")
    assert sorted(tmp_path.iterdir()) == former and {path.read_text() for path in former} == {"former"}


def test_a_former_picture_is_not_deleted_where_the_table_cannot_be_written(tmp_path):
    (tmp_path / "new_balls.png").write_bytes(b"former")
    (tmp_path / "new.toml").mkdir()
    with pytest.raises(InputError):
        written(tmp_path / "new.toml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new.toml", "new_balls.png"]
