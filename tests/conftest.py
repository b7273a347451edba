"""What every test may use, and the record that tests/run.py counts from."""

import json
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
RECORD = os.environ.get("IRPSO_TEST_RECORD")  # a file; tests/run.py reads it even when this process has died


class _RootIsNoPackage:
    """Keeps pytest from importing the ``__init__.py`` at the root, which is there for Blender only."""

    @staticmethod
    def pytest_collect_directory(path, parent):
        return pytest.Dir.from_parent(parent, path=path) if path == ROOT else None


def pytest_configure(config):
    config.pluginmanager.register(_RootIsNoPackage(), "irpso-root")


def _record(**line):
    if RECORD:
        with open(RECORD, "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def pytest_runtest_logstart(nodeid, location):
    _record(event="start", test=nodeid)


def pytest_runtest_logreport(report):
    if report.when == "call" or report.outcome != "passed":
        reason = report.longrepr[2] if report.skipped and isinstance(report.longrepr, tuple) else ""
        _record(event=report.outcome, test=report.nodeid, reason=reason)


def pytest_runtest_logfinish(nodeid, location):
    _record(event="finish", test=nodeid)


def pytest_collectreport(report):
    if not report.passed:
        reason = report.longrepr[2] if report.skipped and isinstance(report.longrepr, tuple) else ""
        _record(event=report.outcome, test=report.nodeid, reason=reason)


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of captures that are too large for the repository; tests that ask for it skip where it is absent."""
    folder = Path(os.environ.get("IRPSO_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("the shared test data are not beside the repository; set IRPSO_DATA to their folder")
    return folder
