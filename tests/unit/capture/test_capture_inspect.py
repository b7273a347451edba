"""What inspect says of sound and of suspicious captures."""

import numpy as np
import pytest

from irpso_addon.capture import read_capture, write_exr
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.inspect import checks, sufficiency
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.capture.light_geometry import flatness
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from tests.builders.captures import LIGHTS, shade, sphere, write_diligent

NORMALS, MASK = sphere(64)
RNG = np.random.default_rng(11)
TEXTURE = RNG.random((64, 64))
# Twelve lights on two rings.
_AROUND = np.arange(12) * np.pi / 6
_TILT = np.where(np.arange(12) % 2, 0.4, 0.8)
RINGS = np.stack([_TILT * np.cos(_AROUND), _TILT * np.sin(_AROUND), np.sqrt(1 - _TILT**2)], axis=-1)
FRAMES = shade(NORMALS, RINGS) * (0.4 + 0.6 * TEXTURE)
GLOSS = {"roughness", "two lobes"}  # what needs many lights


def report(folder, frames=FRAMES, lights=RINGS, mask=MASK, **more):
    return inspect_capture(write_diligent(folder, frames, lights, mask, **more))


def finding(found, code):
    return next(f.message for f in found.findings if f.code == code)


def test_a_sound_capture_has_facts_and_no_findings(tmp_path):
    found = report(tmp_path)
    assert found.findings == () and found.usable
    facts = dict(found.facts)
    assert facts["images"] == "12" and facts["lights"] == "12 distant, 0 near" and facts["formats"] == "12 exr"
    assert facts["camera"] == f"64×64 orthographic, mask keeps {MASK.sum()} ({MASK.mean():.1%})"
    text = "\n".join(found.lines())
    assert str(tmp_path) in text and text.endswith("nothing suspicious")


def test_lights_of_another_length_than_1_are_reported_with_their_line(tmp_path):
    found = report(tmp_path, lights=RINGS * np.where(np.arange(12) == 3, 1.01, 1)[:, None])
    assert found.codes == {"lights_not_unit"} and "line 4: 1 direction is not" in finding(found, "lights_not_unit")
    assert "give them as light_position in a capture.toml" in finding(found, "lights_not_unit")
    assert checks.not_unit(np.array([[0, 0, 1], [0, 0, 1.0009], [0, 0, 1.0011]])).tolist() == [False, False, True]


def test_lights_in_one_plane_are_reported(tmp_path):
    angle = np.linspace(-1, 1, 12)
    fan = np.stack([np.sin(angle), np.zeros(12), np.cos(angle)], axis=-1)
    found = report(tmp_path / "flat", shade(NORMALS, fan), fan)
    assert "lights_coplanar" in found.codes and not found.usable
    tilted = fan + [0, 0.03, 0] * np.where(np.arange(12) % 2, 1, -1)[:, None]
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    found = report(tmp_path / "nearly", shade(NORMALS, tilted), tilted)
    assert "lights_coplanar" in found.codes and found.usable
    # Of three orthogonal lights the singular values are all 1.
    assert flatness(np.eye(3)) == pytest.approx(1) and flatness(np.eye(3)[:2]) == 0


def test_two_lights_are_too_few(tmp_path):
    found = report(tmp_path, FRAMES[:2], RINGS[:2])
    assert found.codes == {"lights_few"} and not found.usable


@pytest.mark.parametrize("count", [1, 2])
def test_lights_without_a_normal_suffice_for_nothing(tmp_path, count):
    found = report(tmp_path, FRAMES[:count], RINGS[:count])
    assert dict(found.facts)["enough for"] == "not for normals (few), roughness (few), two lobes (few)"
    assert f"has {count} light{'s' * (count > 1)}; a normal needs at least three" in finding(found, "lights_few")


def near(*places):
    return [Light(place, (1.0, 1.0, 1.0), False) for place in places]


DISTANT = [Light(tuple(light)) for light in RINGS.tolist()]


@pytest.mark.parametrize(
    ("lights", "code"),
    [
        (DISTANT, None),
        (DISTANT[:3], None),
        (DISTANT[:2], "few"),
        ([DISTANT[0]] * 5, "same"),
        ([*DISTANT[:2]] * 4, "same"),
        ([Light((np.sin(a), 0.0, np.cos(a))) for a in (-1, -0.5, 0.2, 0.7)], "coplanar"),
        (near((1, 0, 2), (-1, 1, 2), (0, -1, 2)), None),
        (near((1, 0, 2), (1, 0, 2), (1, 0, 2), (1, 0, 2)), "same"),
        (near((1, 0, 2), (2, 0, 2), (1, 0, 2), (2, 0, 2)), "same"),
        (near(*((100 + k, 50.0, 200.0) for k in range(6))), "coplanar"),
        (near(*((100 + k, 50.0, 200.0 + k**2) for k in range(6))), None),
        ([*near((0, 0, 3), (0, 0, 3)), DISTANT[0]], "same"),
        ([*near((0, 0, 3)), *DISTANT[:2]], None),
        ([*near((0, 0, 3), (1, 0, 3)), DISTANT[0]], None),
        ([*near((0, 0, 3), (1, 0, 3)), Light((1.0, 0.0, 0.0))], "coplanar"),
    ],
)
def test_degenerate_lights_are_distinguished_from_sufficient_ones(lights, code):
    lack = sufficiency.no_normal(lights)
    assert (lack and lack.code) == code
    # By its definition: the directions from points drawn at random, of full rank at one of them or at none.
    ranks = []
    for point in np.random.default_rng(0).uniform(-1, 1, (5, 3)):
        toward = np.array([np.subtract(light.vector, 0 if light.distant else point) for light in lights])
        ranks.append(np.linalg.matrix_rank(toward / np.linalg.norm(toward, axis=1, keepdims=True), tol=1e-6))
    assert (max(ranks) == 3) == (code is None)


def test_near_lights_at_one_position_suffice_for_nothing(tmp_path):
    write_diligent(tmp_path, FRAMES[:5], RINGS[:5])
    rows = "".join(f'[[observation]]\nimage = "{k:03d}.exr"\nlight_position = [0, 0, 2]\n' for k in range(5))
    (tmp_path / "capture.toml").write_text(f"[[camera]]\n{rows}")
    found = inspect_capture(tmp_path)
    assert dict(found.facts)["enough for"] == "not for normals (same), roughness (same), two lobes (same)"
    assert "has 5 images under 1 different light; a normal" in finding(found, "lights_same") and not found.usable


def even_lights(count, degrees=73.0, across=1.0, seed=0):
    """Lights even over a cap of the sphere, in random order, squeezed in y."""
    rng = np.random.default_rng(seed)
    z = 1 - (1 - np.cos(np.radians(degrees))) * (np.arange(count) + 0.5) / count
    turn = rng.permutation(count) / count * 2 * np.pi
    flat = np.sqrt(1 - z**2)
    x, y = flat * np.cos(turn), across * flat * np.sin(turn)
    return np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1)


@pytest.mark.parametrize("degrees", [5, 20, 45, 73])
def test_the_half_angle_of_a_cap_of_lights_is_found_wherever_it_points(degrees):
    lights = even_lights(2000, degrees)
    turn, _ = np.linalg.qr(RNG.standard_normal((3, 3)))
    assert sufficiency.half_angle(lights @ turn) == pytest.approx(degrees, rel=0.01)


def test_the_spread_across_a_fan_is_its_width_over_its_length():
    # Cosines of two directions squeezed apart: standard deviations .5 and .1 about an axis of 1.
    assert sufficiency.spread_across(even_lights(5000, 60, 0.2)) == pytest.approx(0.2, rel=0.03)
    assert sufficiency.spread_across(even_lights(5000, 60)) == pytest.approx(1, rel=0.03)


def test_lights_nearer_than_all_measured_ones_have_no_figure_of_a_set_that_suffices():
    narrow = even_lights(200, 4)
    for goal, said in (
        ("normals", "spread them over 10° or more (we have not measured less)"),
        ("two lobes", "spread them over 20° or more (in our test with 50 lights within 10°, 35% of the texels failed)"),
    ):
        (lack,) = [found for found in sufficiency.shortfalls(goal, 200, narrow) if found.code == "narrow"]
        assert said in lack.message


@pytest.mark.parametrize(
    ("count", "short", "said"),
    [
        (100, {}, ""),
        (50, {}, ""),
        (30, {"two lobes"}, "30 lights are few for two lobes; take 50 or more (in our test with 20 lights, on a"),
        (20, {"two lobes"}, "interreflection, 15% of the texels failed)"),
        (12, GLOSS, "12 lights are few for roughness; take 20 or more (in our test with 10 lights"),
        (7, {"normals", *GLOSS}, "7 lights are few for normals; take 10 or more (in our test with 5 lights"),
    ],
)
def test_too_few_lights_for_a_goal_are_reported_with_the_measured_figure(count, short, said):
    lights = even_lights(count)
    found = {goal: list(sufficiency.shortfalls(goal, count, lights)) for goal in sufficiency.GOALS}
    assert {goal for goal, lacks in found.items() if lacks} == set(short)
    assert all(lack.code == "few" for lacks in found.values() for lack in lacks)
    assert said in "\n".join(lack.message for lacks in found.values() for lack in lacks)


@pytest.mark.parametrize(
    ("degrees", "across", "codes"),
    [(73, 1, set()), (46, 1, set()), (22, 1, set()), (17, 1, {"narrow"}), (12, 1, {"narrow"}), (73, 0.03, {"flat"})],
)
def test_narrow_or_flat_lights_for_two_lobes_are_reported(degrees, across, codes):
    lacks = list(sufficiency.shortfalls("two lobes", 200, even_lights(200, degrees, across)))
    assert {lack.code for lack in lacks} == codes
    assert not list(sufficiency.shortfalls("normals", 200, even_lights(200, degrees, across)))
    if degrees == 17:
        assert "within about 17°" in lacks[0].message and "50 lights within 10°, 35% of" in lacks[0].message


def test_shortfalls_are_reported_for_the_goals_only(tmp_path):
    path = write_diligent(tmp_path, FRAMES, RINGS, MASK)
    assert inspect_capture(path).findings == ()
    assert dict(inspect_capture(path).facts)["enough for"].startswith("normals; not for roughness (few")
    found = inspect_capture(path, goals=("normals", "roughness"))
    assert found.codes == {"lights_few"} and found.usable
    assert "12 lights are few for roughness; take 20 or more" in finding(found, "lights_few")


def test_a_repeated_light_is_reported(tmp_path):
    lights = RINGS.copy()
    lights[7] = lights[2]
    found = report(tmp_path, lights=lights)
    assert "line 8: the same light as" in finding(found, "lights_same")


def test_two_cameras_may_have_the_same_lights(tmp_path):
    images = [np.repeat(frame[..., None], 3, axis=-1).astype(np.float32) for frame in FRAMES[:4]]
    observations = [
        Observation(f"{camera} {k}", lambda k=k: np.dstack([images[k], np.ones((64, 64), np.float32)]),
                    Light(tuple(RINGS[k].tolist())), camera)
        for camera in (0, 1) for k in range(4)
    ]  # fmt: skip
    cameras = (Camera.orthographic(64, 64, 2.0), Camera.orthographic(64, 64, 2.0, np.diag([-1.0, 1, -1, 1])))
    write_capture(Capture("pair", tuple(observations), cameras, (MASK, MASK)), tmp_path / "pair")
    assert "lights_same" not in inspect_capture(tmp_path / "pair").codes


def test_a_transposed_table_is_reported(tmp_path):
    write_diligent(tmp_path, FRAMES, RINGS, MASK)
    np.savetxt(tmp_path / "light_directions.txt", RINGS.T)
    found = inspect_capture(tmp_path)
    assert found.codes == {"lights_transposed"} and not found.usable


@pytest.mark.parametrize(
    ("signs", "code", "word"),
    [
        ((1, -1, 1), "mirrored", "negate y"),
        ((-1, 1, 1), "mirrored", "negate x"),
        ((-1, -1, 1), "turned", "if it bulges outward, negate x and y"),
        ((1, 1, -1), "lights_reversed", "toward the light"),
    ],
)
def test_mirrored_axes_are_distinguished(tmp_path, signs, code, word):
    wavy, mask = waves()
    found = report(tmp_path, shade(wavy, RINGS), RINGS * signs, mask)
    assert found.codes == {code} and word in finding(found, code)


def test_upside_down_images_are_reported(tmp_path):
    wavy, mask = waves()
    found = report(tmp_path, shade(wavy, RINGS)[:, ::-1], RINGS, mask[::-1])
    assert found.codes == {"mirrored"} and "upside down" in finding(found, "mirrored")


def waves():
    """A ball with waves along its diagonals, whose p and q therefore depend on both x and y."""
    size = 96
    y, x = (np.mgrid[:size, :size] + 0.5) / size * 2.2 - 1.1
    mask = x**2 + y**2 < 0.9
    height = np.sqrt(np.maximum(1.05 - x**2 - y**2, 0.1)) + 0.06 * np.sin(7 * (x + y)) + 0.04 * np.sin(5 * (x - 2 * y))
    q, p = np.gradient(height, 2.2 / size)
    normals = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True) * mask[..., None], mask


def test_the_mirror_test_follows_the_mixed_derivative():
    # z = xy has p = y, q = x: both cross derivatives are 1. Mirrored in y the normals have p = y, q = −x.
    y, x = np.mgrid[:9, :9] / 9.0
    for sign in (1, -1):
        normals = np.stack([-y, -sign * x, np.ones_like(x)], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        assert checks.mirror_agreement(normals, np.ones((9, 9), bool)) == (sign, 64)


def test_ball_normals_point_outward():
    x, y, count = checks.outward_components(NORMALS, MASK)
    assert count > 100 and 0.2 < x < 0.6 and y == pytest.approx(x, rel=0.05)
    assert checks.outward_components(NORMALS * [-1, 1, 1], MASK)[0] == pytest.approx(-x)


def test_checks_use_each_cameras_own_axes(tmp_path):
    # The camera looks along −x: what is right for it is −z… of the world; the lights are turned with it.
    turn = np.array([[0, 0, 1, 4], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    wavy, mask = waves()
    frames = shade(wavy, RINGS)
    write_exr(tmp_path / "all.exr", {f"{k}": {"Y": f} for k, f in enumerate(frames)} | {"mask": {"Y": mask * 1.0}})
    for sign in (1, -1):
        world = (RINGS * [1, sign, 1]) @ turn[:3, :3].T
        rows = "".join(
            f'[[observation]]\npart = "{k}"\nlight_direction = {light.tolist()}\n' for k, light in enumerate(world)
        )
        (tmp_path / "capture.toml").write_text(
            f'image = "all.exr"\n[[camera]]\nmask = "all.exr"\nmask_part = "mask"\nmatrix = {turn.tolist()}\n{rows}'
        )
        assert len(read_capture(tmp_path).observations) == 12
        assert inspect_capture(tmp_path).codes == (set() if sign == 1 else {"mirrored"})


def test_five_lights_about_the_axis_are_not_suspicious():
    assert flatness(LIGHTS) > 0.2 and not checks.same_lights(LIGHTS)


@pytest.mark.parametrize("shape", [(16, 17_000), (17_000, 16), (64, 16_384), (20, 300), (1, 500), (2, 2), (1, 1)])
def test_a_strip_of_any_width_is_checked(tmp_path, shape):
    texture = np.random.default_rng(2).random(shape)
    frames = np.stack([(0.5 + 0.1 * k) * texture for k in range(3)]).astype(np.float32)
    found = report(tmp_path, frames, RINGS[:3], None, half=True)
    assert dict(found.facts)["camera"].startswith(f"{shape[1]}×{shape[0]} ")
    assert not found.codes - {"lights_few"}
