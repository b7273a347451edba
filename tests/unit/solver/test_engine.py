"""The contract of a recovery: all four ways to solve a domain have it, with the same signatures."""

import inspect

import pytest

from irpso_addon.cluster.recovery import RankedRecovery
from irpso_addon.solver.engine.coarse_to_fine import Pyramid
from irpso_addon.solver.engine.engine import RecoveryEngine
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery

DEFAULTS = {"refresh_confidence", "view", "deviation_pass", "tiles", "phase", "reconfigure"}
OPTIONAL = {"prepared"}  # of a whole recovery, which others do not know of


def parameters(function):
    found = inspect.signature(function).parameters.values()
    return [(p.name, p.kind, p.default, p.annotation) for p in found if p.name not in OPTIONAL]


@pytest.mark.parametrize("engine", [Recovery, Pyramid, TiledRecovery, RankedRecovery])
def test_every_recovery_is_a_recovery_engine(engine):
    assert RecoveryEngine in engine.__mro__
    for name, wanted in vars(RecoveryEngine).items():
        if name.startswith("_"):
            continue
        found, own = getattr(engine, name), name in vars(engine)
        if inspect.isfunction(wanted):
            assert own or name in DEFAULTS | {"save", "load"}, name
            assert parameters(found) == parameters(wanted), name
        elif isinstance(wanted, property):
            assert own or name in DEFAULTS, name
