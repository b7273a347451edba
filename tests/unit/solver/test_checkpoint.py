"""Checkpoints: exact, whole or not there, and refused where they are damaged or belong to another recovery."""

import dataclasses
import io
import json
import os
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.errors import CheckpointError, InputError
from irpso_addon.core.paths import SHADERS
from irpso_addon.geometry.domain import tile, with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.halo import own_rows, place_of, tile_rows
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state import checkpoint
from irpso_addon.solver.state.layout import TexelLayout, digest_of_texels, joined, numbered
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.phase_textures import plan_atlas
from irpso_addon.solver.state.prefit_measurements import PrefitMeasurements
from tests.builders.domains import make_domain

WHO = {"seed": 3, "model": "lambert"}
ARRAYS = {"position": np.arange(24, dtype=np.float32).reshape(2, 3, 4) / 7, "fitness": np.full((2, 3), np.nan, "f")}


@pytest.fixture
def saved(tmp_path):
    """The path of a checkpoint."""
    path = tmp_path / "run.irpso"
    checkpoint.write(path, WHO, checkpoint.Checkpoint(1, -4, 12345678901, ARRAYS))
    return path


def test_a_checkpoint_reads_back_bit_for_bit(saved):
    found = checkpoint.read(saved, WHO)
    assert (found.stage, found.iteration, found.evaluations) == (1, -4, 12345678901)
    assert found.arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert found.arrays[name].tobytes() == array.tobytes() and found.arrays[name].shape == array.shape
    assert os.listdir(saved.parent) == ["run.irpso"]


def test_a_checkpoint_replaces_the_one_before(saved):
    checkpoint.write(saved, WHO, checkpoint.Checkpoint(2, 7, 1, ARRAYS))
    assert checkpoint.read(saved, WHO).iteration == 7
    assert os.listdir(saved.parent) == ["run.irpso"]


def test_a_truncated_checkpoint_is_refused_at_any_length(saved):
    data = saved.read_bytes()
    for length in range(0, len(data), 7):
        saved.write_bytes(data[:length])
        with pytest.raises(InputError, match="no checkpoint, or a damaged one"):
            checkpoint.read(saved, WHO)


def test_a_changed_byte_is_refused_or_changes_nothing(saved):
    data = saved.read_bytes()
    refused = 0
    for at in range(0, len(data), 3):
        for value in (data[at] ^ 1, data[at] ^ 128):
            saved.write_bytes(data[:at] + bytes([value]) + data[at + 1 :])
            try:
                found = checkpoint.read(saved, WHO)
            except InputError as error:
                assert "\n" not in str(error) and str(saved) in str(error)
                refused += 1
            else:
                assert all(found.arrays[name].tobytes() == array.tobytes() for name, array in ARRAYS.items())
                assert (found.stage, found.iteration, found.evaluations) == (1, -4, 12345678901)
    assert refused > 0.4 * len(data)


def npz(**arrays) -> bytes:
    """Return the bytes of an .npz file."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def text(value) -> np.ndarray:
    """Return JSON as the bytes that a checkpoint holds."""
    return np.frombuffer(json.dumps(value).encode(), np.uint8)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not a checkpoint",
        b"PK\x03\x04",
        npz(position=np.ones(3)),
        npz(about=text({})),
        npz(about=text([])),
        npz(about=text({"version": checkpoint._VERSION})),
        npz(about=text({"version": checkpoint._VERSION, "identity": WHO, "arrays": {}, "stage": 0})),
        npz(about=np.ones(3)),
    ],
)
def test_another_kind_of_file_is_refused(tmp_path, content):
    path = tmp_path / "other"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no checkpoint, or a damaged one; start without --resume"):
        checkpoint.read(path, WHO)


def test_a_plain_array_file_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.ones(3))
    with pytest.raises(InputError, match="no checkpoint"):
        checkpoint.read(tmp_path / "a.npy", WHO)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            checkpoint.read(path, WHO)


def test_a_checkpoint_under_former_rules_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "run.irpso"
    with monkeypatch.context() as patched:
        patched.setattr(checkpoint, "_VERSION", 7)  # other scales of dark texels, and other priors
        checkpoint.write(path, WHO, checkpoint.Checkpoint(1, -4, 9, ARRAYS))
    for ask in (checkpoint.read, checkpoint.glance):
        with pytest.raises(CheckpointError, match="of another version of the program; finish it there, or leave out"):
            ask(path, WHO)


def test_a_checkpoint_of_another_version_is_refused(saved, monkeypatch):
    monkeypatch.setattr(checkpoint, "_VERSION", checkpoint._VERSION + 1)
    with pytest.raises(InputError, match="of another version"):
        checkpoint.read(saved, WHO)


def test_a_failed_checkpoint_leaves_no_file_and_keeps_the_old(saved, monkeypatch):
    before = saved.read_bytes()

    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(InputError, match="No space left on device"):
        checkpoint.write(saved, WHO, checkpoint.Checkpoint(9, 9, 9, ARRAYS))
    assert os.listdir(saved.parent) == ["run.irpso"] and saved.read_bytes() == before


DOMAIN = make_domain(4, 5, holes=False)
SETTINGS = {"model": load_model("lambert"), "schedule": load_schedule("swarm"), "seed": 1, "entry": "fragment"}
KNOWN = {"normal": np.zeros((4, 5, 3), np.float32)}


def changed(part: str):
    """Return the domain with one number of a part of it changed by the smallest step."""
    owner = DOMAIN.bake if hasattr(DOMAIN.bake, part) else DOMAIN
    array = (DOMAIN.stack.values if part == "stack" else getattr(owner, part)).copy()
    first = (0,) * array.ndim
    array[first] = not array[first] if array.dtype == bool else np.nextafter(array[first], np.float32(9))
    if part == "stack":
        return with_samples(DOMAIN, array)
    if owner is DOMAIN:
        return dataclasses.replace(DOMAIN, **{part: array})
    return dataclasses.replace(DOMAIN, bake=dataclasses.replace(DOMAIN.bake, **{part: array}))


PARTS = {
    "stack": "observations", "lights": "observations", "intensities": "observations", "views": "observations",
    "position": "geometry", "normal": "geometry", "tangent": "geometry", "coverage": "geometry",
}  # fmt: skip


@pytest.mark.parametrize("part", PARTS)
def test_a_domain_with_one_changed_number_is_another(tmp_path, part):
    path = tmp_path / "run.irpso"
    checkpoint.write(path, checkpoint.identity(DOMAIN, **SETTINGS), checkpoint.Checkpoint(0, 0, 0, ARRAYS))
    checkpoint.read(path, checkpoint.identity(DOMAIN, **SETTINGS))
    with pytest.raises(InputError, match=f"of another recovery: .*{PARTS[part]} differ"):
        checkpoint.read(path, checkpoint.identity(changed(part), **SETTINGS))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"seed": 2}, r"seed differs \(seed 1 there, 2 here\)"),
        ({"entry": "compute"}, r"entry differs \(entry fragment there, compute here\)"),
        ({"schedule": load_schedule("paper")}, r"preset differs \(in the preset .*stages"),
        ({"schedule": load_schedule("swarm").replaced(c1=1.3)}, r"preset differs \(in the preset c1\); start without"),
        ({"model": load_model("principled")}, "model, parameters, shader"),
        ({"fixed": KNOWN}, "fixed"),
    ],
)
def test_other_settings_are_another_recovery_and_are_named(tmp_path, change, what):
    path = tmp_path / "run.irpso"
    checkpoint.write(path, checkpoint.identity(DOMAIN, **SETTINGS), checkpoint.Checkpoint(0, 0, 0, ARRAYS))
    for ask in (checkpoint.read, checkpoint.glance):
        with pytest.raises(CheckpointError, match=f"of another recovery: {what}"):
            ask(path, checkpoint.identity(DOMAIN, **(SETTINGS | change)))


def test_a_changed_line_in_a_file_that_a_models_shader_includes_is_another_recovery(tmp_path):
    (tmp_path / "mine.toml").write_bytes((SHADERS / "models" / "lambert.toml").read_bytes())
    shader = (SHADERS / "models" / "lambert.glsl").read_text(encoding="utf-8")
    (tmp_path / "mine.glsl").write_text('#include "terms.glsl"\n' + shader, encoding="utf-8")
    (tmp_path / "terms.glsl").write_text('#include "deeper.glsl"\n', encoding="utf-8")
    (tmp_path / "deeper.glsl").write_text("const float GAIN = 1.0;\n", encoding="utf-8")
    settings = SETTINGS | {"model": load_model(tmp_path / "mine.toml")}
    checkpoint.write(tmp_path / "run", checkpoint.identity(DOMAIN, **settings), checkpoint.Checkpoint(0, 0, 0, ARRAYS))
    checkpoint.read(tmp_path / "run", checkpoint.identity(DOMAIN, **settings))
    (tmp_path / "deeper.glsl").write_text("const float GAIN = 1.1;\n", encoding="utf-8")
    with pytest.raises(InputError, match="of another recovery: shader differ"):
        checkpoint.read(tmp_path / "run", checkpoint.identity(DOMAIN, **settings))


def test_other_known_maps_are_another_recovery(tmp_path):
    path = tmp_path / "run.irpso"
    checkpoint.write(path, checkpoint.identity(DOMAIN, **SETTINGS, fixed=KNOWN), checkpoint.Checkpoint(0, 0, 0, ARRAYS))
    checkpoint.read(path, checkpoint.identity(DOMAIN, **SETTINGS, fixed=KNOWN))
    with pytest.raises(InputError, match="fixed differ"):
        checkpoint.read(path, checkpoint.identity(DOMAIN, **SETTINGS, fixed={"normal": KNOWN["normal"] + 1}))


def test_a_tile_elsewhere_is_another_recovery(tmp_path):
    path = tmp_path / "run.irpso"
    checkpoint.write(path, checkpoint.identity(DOMAIN, **SETTINGS), checkpoint.Checkpoint(0, 0, 0, ARRAYS))
    for change in ({"origin": (1, 0)}, {"halo": (1, 0, 0, 0)}):
        with pytest.raises(InputError, match="domain, observations differ"):
            checkpoint.read(path, checkpoint.identity(dataclasses.replace(DOMAIN, **change), **SETTINGS))


def test_digests_of_tiles_add_up_to_the_whole():
    domain = make_domain(13, 17)
    whole = digest_of_texels(domain)
    for boxes in ([(0, 0, 17, 13)], [(0, 0, 5, 13), (5, 0, 12, 6), (5, 6, 12, 7)]):
        tiles = [tile(domain, *box, halo=3) for box in boxes]
        assert sum(digest_of_texels(part) for part in tiles) % 2**64 == whole
    other = with_samples(domain, domain.stack.values[:, ::-1].copy())
    vars(other)["solvable"] = domain.solvable
    assert digest_of_texels(other) != whole


def test_samples_of_weight_0_do_not_change_the_digest():
    domain = make_domain(13, 17)
    shown = np.where(domain.stack.values[..., 3:] > 0, domain.stack.values, np.float32([0.7, 0.8, 0.9, 0]))
    other = with_samples(domain, shown)
    assert (shown != domain.stack.values).any()
    assert digest_of_texels(other) == digest_of_texels(domain)


@pytest.mark.parametrize("tiles", [1, 5, 6])
def test_the_state_per_texel_equals_the_atlas(tiles):
    rng = np.random.default_rng(2)
    solvable = np.ones((3, 4), bool)
    solvable[1, 1] = solvable[2, 3] = False
    domain = replace(make_domain(3, 4, holes=False), solvable=solvable)
    layout = TexelLayout(domain)
    width, height = Packing(solvable).width, Packing(solvable).height
    atlas = plan_atlas(width, height, tiles, 64)
    large = rng.random((height * atlas.down, width * atlas.across, 4), np.float32)
    state = {
        "position": large, "best": rng.random((height, width, 1), np.float32),
        "prefit_fitness": rng.random((height, width), np.float32), "phase_materials": np.zeros((7, 3), np.float32),
    }  # fmt: skip
    rows = layout.rows(state, tiles)
    assert {name: value.shape for name, value in rows.items()} == {
        "position": (10, tiles, 4), "best": (10, 1, 1), "prefit_fitness": (10, 1, 1),
    }  # fmt: skip
    for texel in range(10):
        y, x = divmod(texel, width)
        for number in range(tiles):
            down, across = divmod(number, atlas.across)
            np.testing.assert_array_equal(rows["position"][texel, number], large[height * down + y, width * across + x])
    # Packed otherwise, as the tiles of another cut, it is the same texel by texel.
    numbers, parts = numbered(solvable), []
    for box in ((0, 0, 3, 3), (3, 0, 1, 3)):
        held = tile(domain, *box, halo=1)
        moved = TexelLayout(held).arrays({n: r[tile_rows(numbers, place_of(box, held))] for n, r in rows.items()}, 64)
        assert moved["prefit_fitness"].ndim == 2
        parts.append((own_rows(numbers, box), TexelLayout(held).rows(moved, tiles)))
    again = joined(10, parts)
    assert again.keys() == rows.keys() and all((again[name] == rows[name]).all() for name in rows)


def test_a_prefits_measurements_keep_their_names_and_shapes():
    flat, channels = ("fitness", "shadow", "sheen_chosen"), {"indirect_misfit": 4, "sheen": 4, "separation": 14}
    arrays = {f"prefit_{name}": np.random.default_rng(3).random((3, 4), np.float32) for name in flat}
    arrays |= {f"prefit_{name}": np.ones((3, 4, count), np.float32) for name, count in channels.items()}
    measurements = PrefitMeasurements.of_arrays({**arrays, "estimate_0": np.ones((3, 4, 4))})
    assert all(getattr(measurements, field.name) is not None for field in dataclasses.fields(measurements))
    assert {name: id(array) for name, array in measurements.arrays.items()} == {n: id(a) for n, a in arrays.items()}
    layout = TexelLayout(make_domain(3, 4, holes=False))
    again = layout.arrays(layout.rows(measurements.arrays, 1), 64)
    assert again.keys() == arrays.keys() and all(np.array_equal(again[name], arrays[name]) for name in arrays)
    assert PrefitMeasurements.of_arrays({}).arrays == {}
