"""The catalog file of an asset library, as Blender's manual has its format (Asset Catalogs)."""

import errno
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.exports import catalog
from irpso_addon.exports.catalog import CATALOGS, catalog_id

ROOT = Path(__file__).resolve().parents[3]
ADDER = """
import sys
from pathlib import Path
from irpso_addon.exports.catalog import catalog_id
print("ready", flush=True)
sys.stdin.readline()
for number in range(15):
    own = catalog_id(Path(sys.argv[1]), f"Tiles/{sys.argv[2]} {number}")
    print(own, "common", catalog_id(Path(sys.argv[1]), "All"))
"""


def test_a_catalog_files_line_ends_stay(tmp_path):
    theirs = b"VERSION 1\r\n\r\n11111111-2222-3333-4444-555555555555:Stone/Marble:Stone-Marble\r\n"
    (tmp_path / CATALOGS).write_bytes(theirs)
    made = catalog_id(tmp_path, "Leaves")
    assert (tmp_path / CATALOGS).read_bytes() == theirs + f"{made}:Leaves:Leaves\r\n".encode()


def test_a_catalog_is_made_once_and_others_stay(tmp_path):
    theirs = "# mine\nVERSION 1\n\n11111111-2222-3333-4444-555555555555:Stone/Marble:marble"
    (tmp_path / CATALOGS).write_text(theirs)
    assert catalog_id(tmp_path, "Stone/ Marble") == "11111111-2222-3333-4444-555555555555"
    made = catalog_id(tmp_path, "Stone")
    assert catalog_id(tmp_path, "Stone") == made and (tmp_path / CATALOGS).read_text().startswith(theirs + "\n")
    for wrong in ("", "a//b", "a:b", "/a"):
        with pytest.raises(InputError, match="single slashes"):
            catalog_id(tmp_path, wrong)


def test_processes_that_add_catalogs_at_once_lose_none_and_share_those_of_one_name(tmp_path):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": ROOT}
    adders = [subprocess.Popen([sys.executable, "-c", ADDER, str(tmp_path), str(who)], **pipes) for who in range(4)]
    for adder in adders:
        assert adder.stdout.readline() == "ready\n"
    for adder in adders:
        adder.stdin.write("go\n")
        adder.stdin.flush()
    said = [line.split(" common ") for adder in adders for line in adder.communicate()[0].splitlines()]
    lines = (tmp_path / CATALOGS).read_text().splitlines()
    there = {line.split(":")[0] for line in lines if ":" in line and not line.startswith("#")}
    assert len(said) == 60 and {own for own, _ in said} <= there
    assert len({common for _, common in said}) == 1 and len(there) == 61
    assert [path.name for path in tmp_path.iterdir()] == [CATALOGS]


def test_a_process_that_was_killed_while_it_changed_the_file_blocks_others_for_a_while_only(tmp_path, monkeypatch):
    monkeypatch.setattr(catalog, "_WAIT", 0.1)
    (tmp_path / f".{CATALOGS}.lock").touch()
    assert catalog_id(tmp_path, "Stone") in (tmp_path / CATALOGS).read_text()
    assert [path.name for path in tmp_path.iterdir()] == [CATALOGS]


def test_one_process_at_a_time_takes_over_from_a_killed_one(tmp_path, monkeypatch):
    monkeypatch.setattr(catalog, "_WAIT", 0.6)
    lock, unlink = tmp_path / f".{CATALOGS}.lock", Path.unlink
    lock.touch()
    inside, most, slow = [], [], []

    def unlink_slowly(path, missing_ok=False):
        if path == lock and threading.current_thread().name == "second" and not slow:
            slow.append(True)
            time.sleep(0.2)  # of a network, meanwhile the other one may take the lock
        unlink(path, missing_ok=missing_ok)

    def change():
        with catalog._held(tmp_path / CATALOGS):
            inside.append(1)
            most.append(len(inside))
            time.sleep(0.3)  # longer than that, and shorter than of a killed process
            inside.pop()

    monkeypatch.setattr(Path, "unlink", unlink_slowly)
    threads = [threading.Thread(target=change, name=name) for name in ("first", "second")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1, 1] and not list(tmp_path.iterdir())


def test_the_lock_of_another_process_is_not_removed(tmp_path):
    lock = tmp_path / f".{CATALOGS}.lock"
    with catalog._held(tmp_path / CATALOGS):
        own = lock.read_text()
        lock.write_text("theirs")  # as if this process had been suspended and taken for killed
    assert lock.read_text() == "theirs" and str(os.getpid()) in own.split()


def test_a_lock_that_cannot_be_removed_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(catalog, "_WAIT", 0.05)
    lock, unlink = tmp_path / f".{CATALOGS}.lock", Path.unlink
    lock.touch()

    def refuse(path, missing_ok=False):
        if path == lock:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        unlink(path, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(InputError, match=r"\.lock: cannot be replaced \(Permission denied\).*; delete this file"):
        catalog_id(tmp_path, "Stone")
    assert [path.name for path in tmp_path.iterdir()] == [lock.name]


def test_a_library_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(catalog, "_WAIT", 0.1)
    with pytest.raises(InputError, match=rf"{CATALOGS}: cannot be written .*; choose another library"):
        catalog_id(tmp_path / "gone", "Stone")
