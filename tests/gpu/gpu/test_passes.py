"""Passes: which texels they touch, their bands of rows, and when their programs are compiled."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import GpuUnavailableError
from irpso_addon.gpu import context, program, textures
from irpso_addon.gpu.bands import Bands
from irpso_addon.gpu.kernel import Kernel, Output, Packed
from irpso_addon.gpu.passes import Pass
from irpso_addon.gpu.program import ProgramCache
from irpso_addon.solver.kernels.single_passes import copy_pass

pytestmark = pytest.mark.usefixtures("gpu")

KERNELS = Path(__file__).parents[1] / "kernels"
CONSTANTS = {"u_mark": "INT", "u_skip": "INT", "u_scale": "FLOAT"}
BEFORE = -7.0


@pytest.fixture(params=["fragment", "compute"])
def entry(request):
    """Both entries."""
    return request.param


def marks(entry, width, height, outputs=1, rows=None, skip=0):
    """Run the kernel that marks where it runs on cleared targets; return what they hold."""
    formats = ["R32F" if i == 1 else "RGBA32F" for i in range(outputs)]
    given = tuple(Output(f"o_{i}", name) for i, name in enumerate(formats))
    work = Pass(Kernel(KERNELS / "marks.glsl", given, {}, CONSTANTS, {"OUTPUTS": outputs}), entry)
    targets = [textures.empty(width, height, name, value=BEFORE) for name in formats]
    for each in rows or [None]:
        work.run(targets, {}, {"u_mark": 5, "u_skip": skip, "u_scale": 0.1}, each)
    result = [read(target) for target in targets]
    work.close()
    return result


def read(target):
    """Return a target's contents, copied by a fragment pass: what a dispatch wrote is not read directly."""
    copy, result = copy_pass(), textures.empty(target.width, target.height)
    copy.run([result], {"u_source": target})
    array = textures.download(result)
    copy.close()
    return array[..., : textures.CHANNELS[target.format]]


def expected(width, height):
    """Return what a texel is marked with."""
    y, x = np.mgrid[:height, :width]
    return np.stack([x, y, np.full_like(x, 5), np.full(x.shape, np.float32(0.1))], axis=-1).astype(np.float32)


@pytest.mark.parametrize("size", [(1, 1), (7, 1), (1, 9), (8, 8), (9, 8), (17, 13), (63, 65), (100, 3)], ids=str)
def test_every_texel_runs_once_at_its_own_place(entry, size):
    np.testing.assert_array_equal(marks(entry, *size)[0], expected(*size))


@pytest.mark.parametrize("rows", [(0, 1), (5, 6), (12, 13), (3, 11), (0, 13), (8, 9), (7, 8)], ids=str)
def test_a_band_of_rows_leaves_the_other_rows_alone(entry, rows):
    found = marks(entry, 17, 13, rows=[rows])[0]
    wanted = np.full((13, 17, 4), BEFORE, np.float32)
    wanted[rows[0] : rows[1]] = expected(17, 13)[rows[0] : rows[1]]
    np.testing.assert_array_equal(found, wanted)


def test_blending_of_a_draw_callback_does_not_affect_a_pass(entry):
    import gpu

    gpu.state.blend_set("ALPHA")
    try:
        found = marks(entry, 17, 13)[0]
        assert gpu.state.blend_get() == "ALPHA"
    finally:
        gpu.state.blend_set("NONE")
    np.testing.assert_array_equal(found, expected(17, 13))


def test_bands_one_after_the_other_make_the_whole(entry):
    found = marks(entry, 17, 13, rows=[(0, 3), (3, 4), (4, 12), (12, 13)])[0]
    np.testing.assert_array_equal(found, expected(17, 13))


@pytest.mark.parametrize("skip", [1, 2, 3])
def test_a_kernel_that_returns_false_writes_no_output(entry, skip):
    found = marks(entry, 17, 13, outputs=3, skip=skip)
    y, x = np.mgrid[:13, :17]
    left = (x + y) % skip == 0
    for i, array in enumerate(found):
        assert (array[left] == BEFORE).all()
        assert (array[~left] != BEFORE).all(), i


@pytest.mark.parametrize("outputs", range(1, 7))
def test_up_to_six_outputs_of_two_formats_are_each_written(entry, outputs):
    found = marks(entry, 9, 5, outputs=outputs)
    y, x = np.mgrid[:5, :9]
    for i, array in enumerate(found):
        wanted = (1000.0 * y + x)[..., None] if i == 1 else expected(9, 5) + np.float32(i)
        np.testing.assert_array_equal(array, wanted.astype(np.float32))


def test_a_seventh_output_is_refused_before_a_shader_is_made(entry):
    outputs = tuple(Output(f"o_{i}") for i in range(7))
    with pytest.raises(ValueError, match="has 7"):
        Pass(Kernel(KERNELS / "marks.glsl", outputs, {}, CONSTANTS, {"OUTPUTS": 1}), entry)


def test_a_pass_runs_again_on_other_targets_of_another_size(entry):
    work = Pass(Kernel(KERNELS / "marks.glsl", (Output("o_0"),), {}, CONSTANTS, {"OUTPUTS": 1}), entry)
    for size in ((5, 3), (20, 30), (5, 3)):
        target = textures.empty(*size, value=BEFORE)
        work.run([target], {}, {"u_mark": 5, "u_skip": 0, "u_scale": 0.1})
        np.testing.assert_array_equal(read(target), expected(*size))
    work.close()


def test_a_pass_keeps_few_of_many_targets_alive():
    work = Pass(Kernel(KERNELS / "marks.glsl", (Output("o_0"),), {}, CONSTANTS, {"OUTPUTS": 1}))
    for _ in range(40):
        target = textures.empty(3, 2, value=BEFORE)
        work.run([target], {}, {"u_mark": 5, "u_skip": 0, "u_scale": 0.1})
        np.testing.assert_array_equal(read(target)[..., 2], 5)
    assert len(work._framebuffers) < 20
    work.close()


def test_a_fence_is_waited_at_before_anything_was_drawn(entry):
    work = Pass(Kernel(KERNELS / "marks.glsl", (Output("o_0"),), {}, CONSTANTS, {"OUTPUTS": 1}), entry)
    target = textures.empty(5, 3, value=BEFORE)
    work.fence([target])
    np.testing.assert_array_equal(textures.download(target), np.full((3, 5, 4), BEFORE))
    work.close()


@pytest.mark.parametrize("seconds", [1e-9, 1e-4, 10.0])
@pytest.mark.parametrize("height", [1, 5, 64, 333])
def test_bands_cover_every_row_once_whatever_time_they_are_given(seconds, height):
    bands = Bands()
    for _ in range(70):
        drawn = []
        for _ in bands.run("pass", height, seconds, drawn.append, lambda: None):
            pass
        assert [row for first, last in drawn for row in range(first, last)] == list(range(height))


class Costs:
    """A clock that a draw advances: each row costs its own time, and nothing else does."""

    def __init__(self, seconds_per_row):
        self.now, self.costs, self.bands = 0.0, np.asarray(seconds_per_row), []

    def perf_counter(self):
        return self.now

    def draw(self, rows):
        cost = self.costs[rows[0] : rows[1]].sum()
        self.bands.append(cost)
        self.now += cost


@pytest.mark.parametrize("paced", [True, False])
def test_the_first_bands_of_a_pass_are_short_and_later_ones_meet_the_budget(monkeypatch, paced):
    clock = Costs(np.full(512, 1e-3))
    monkeypatch.setattr("irpso_addon.gpu.bands.time", clock)
    bands = Bands(paced)
    for _ in range(3):
        for _ in bands.run("pass", 512, 0.02, clock.draw, lambda: None):
            pass
    assert max(clock.bands) <= 0.02 + 1e-9
    assert max(clock.bands[:2]) <= 0.008 + 1e-9  # nothing is known of it yet
    assert np.median(clock.bands[4:]) >= 0.016


def test_an_expensive_region_does_not_stall_once_measured(monkeypatch):
    clock = Costs(np.where(np.arange(512) < 256, 1e-5, 1e-3))  # texels that are done cost little
    monkeypatch.setattr("irpso_addon.gpu.bands.time", clock)
    bands = Bands(paced=True)
    for run in range(4):
        clock.bands.clear()
        for _ in bands.run("pass", 512, 0.02, clock.draw, lambda: None):
            pass
        assert run == 0 or max(clock.bands) < 0.08
        assert sum(cost > 0.021 for cost in clock.bands) <= 2


@pytest.mark.parametrize("paced", [True, False])
def test_timed_bands_wait_for_the_gpu(paced):
    bands, order = Bands(paced), []
    for _ in range(20):
        order.clear()
        for _ in bands.run("pass", 64, 1.0, lambda rows: order.append("draw"), lambda: order.append("fence")):
            order.append("look")
    unfenced = sum(a == "draw" and b == "look" for a, b in zip(order, order[1:], strict=False))
    assert (unfenced == 0) == paced


@pytest.fixture
def compiled(monkeypatch):
    """The names of the kernels that are compiled meanwhile, but for the one by which a test reads."""
    names, real = [], program.compile_shader

    def noted(name, *rest):
        if name != "common/copy.glsl":
            names.append(name)
        return real(name, *rest)

    monkeypatch.setattr(program, "compile_shader", noted)
    return names


def ran(entry, mark):
    """Run a pass of its own over a texture; return the pass and what it wrote."""
    work = Pass(Kernel(KERNELS / "marks.glsl", (Output("o_0"),), {}, CONSTANTS, {"OUTPUTS": 1}), entry)
    target = textures.empty(5, 3, value=BEFORE)
    work.run([target], {}, {"u_mark": mark, "u_skip": 0, "u_scale": 0.1})
    return work, read(target)


def test_a_pass_compiles_at_its_first_run(entry, compiled):
    work = Pass(Kernel(KERNELS / "marks.glsl", (Output("o_0"),), {}, CONSTANTS, {"OUTPUTS": 1}), entry)
    assert not compiled
    target = textures.empty(5, 3, value=BEFORE)
    for _ in range(2):
        work.run([target], {}, {"u_mark": 5, "u_skip": 0, "u_scale": 0.1})
        assert len(compiled) == 1
    work.close()


def test_passes_of_one_kernel_compile_once_while_any_has_it(entry, compiled):
    first, five = ran(entry, 5)
    second, seven = ran(entry, 7)
    assert len(compiled) == 1 and (five != seven).any()  # each with its own constants
    first.close()
    third, again = ran(entry, 5)
    assert len(compiled) == 1 and (again == five).all()
    second.close()
    third.close()
    ran(entry, 5)[0].close()
    assert len(compiled) == 2


def test_kept_programs_outlive_their_passes(entry, compiled):
    with closing(ProgramCache()):
        for _ in range(2):
            ran(entry, 5)[0].close()
        assert len(compiled) == 1
    ran(entry, 5)[0].close()
    assert len(compiled) == 2


def test_a_kernel_that_its_file_no_longer_holds_is_compiled_anew(entry, compiled, tmp_path):
    source, target = tmp_path / "mine.glsl", textures.empty(2, 2)
    with closing(ProgramCache()):
        for value in ("1.0", "2.0"):
            source.write_text(f"bool texel_kernel(ivec2 t)\n{{\n    o_0 = vec4({value});\n    return true;\n}}\n")
            work = Pass(Kernel(source, (Output("o_0"),), {}, {}, {}), entry)
            work.run([target], {})
            assert (read(target) == float(value)).all()
            work.close()
    assert len(compiled) == 2


def test_unused_samplers_take_no_texture_unit(entry, monkeypatch):
    monkeypatch.setattr(context, "max_samplers", lambda: 1)
    source, copied = textures.upload(np.full((3, 5, 4), 2.5, np.float32)), textures.empty(5, 3)
    others = {f"u_other_{i}": "FLOAT_2D" for i in range(40)}
    copy = Pass(Kernel("common/copy.glsl", (Output("o_copy"),), {**others, "u_source": "FLOAT_2D"}, {}, {}), entry)
    copy.run([copied], {"u_source": source})
    assert (read(copied) == 2.5).all()
    copy.close()
    monkeypatch.setattr(context, "max_samplers", lambda: 0)
    with pytest.raises(GpuUnavailableError, match=r"reads 0 textures in a shader, common/copy\.glsl needs 1; choose"):
        Pass(copy.kernel, entry).compile()


def test_a_pass_takes_the_constants_that_its_source_names_on_every_backend(entry, tmp_path):
    # OpenGL's compiler removes what it need not compute with; Vulkan keeps every declared constant and wants its value.
    source = tmp_path / "named.glsl"
    source.write_text(
        "bool texel_kernel(ivec2 t)\n{\n    o_0 = vec4(float(u_mark) + 0.0 * float(u_skip * 0));\n    return true;\n}\n"
    )
    work = Pass(Kernel(source, (Output("o_0"),), {}, CONSTANTS, {}), entry)
    target = textures.empty(2, 2, value=BEFORE)
    work.run([target], {}, {"u_mark": 5, "u_skip": 0})
    assert (read(target) == 5).all()
    with pytest.raises(KeyError, match="u_skip"):
        work.run([target], {}, {"u_mark": 5})
    work.close()


def test_packed_numbers_are_read_and_written_four_to_a_texture(entry, tmp_path):
    kernel = tmp_path / "shift.glsl"
    kernel.write_text(
        "bool texel_kernel(ivec2 texel) { float c[12]; float d[12]; read_held(texel, c); read_none(texel, d);"
        " for (int i = 0; i < 12; i++) { d[i] += 10.0 * c[(i + 1) % 12]; } write_found(d); return true; }\n"
    )
    numbers = np.random.default_rng(3).random((3, 5, 8), np.float32)
    inputs = {f"u_held_{i}": textures.upload(numbers[..., 4 * i : 4 * i + 4].copy()) for i in range(2)}
    samplers = {"u_held": Packed(2), "u_none": Packed(0)}
    work = Pass(Kernel(kernel, (Output("o_found", Packed(3)),), samplers, {}, {}), entry)
    targets = [textures.empty(5, 3) for _ in range(3)]
    work.run(targets, inputs)
    found = np.concatenate([read(target) for target in targets], axis=-1)
    padded = np.pad(numbers, ((0, 0), (0, 0), (0, 4)))
    np.testing.assert_array_equal(found, np.float32(10) * np.roll(padded, -1, axis=-1))
    work.close()
