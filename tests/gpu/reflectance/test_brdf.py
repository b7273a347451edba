"""Every BRDF term on the GPU against float64, from grazing to normal and at the smallest roughness."""

import numpy as np
import pytest

from irpso_addon.gpu import textures
from irpso_addon.gpu.kernel import Kernel, Output
from irpso_addon.gpu.passes import Pass
from tests.oracles import reflectance as oracles

EPS = 2.0**-23  # the spacing of float32 at 1; an operation rounds by half of it
KERNELS = "tests/gpu/kernels"
COSINES = np.array([2e-7, 1e-5, 1e-3, 0.02, 0.1, 0.3, 0.6, 0.9, 0.999, 1.0])
ALPHAS = np.array([4e-4, 0.0025, 0.01, 0.05, 0.2, 0.5, 1.0])
THETAS = np.concatenate([[0.0, 1e-5, 1e-4, 4e-4, 1e-3], np.linspace(0.01, 1.57, 40), [np.pi / 2 - 1e-6]])


def grid(*axes):
    """Arguments on the product of axes: float64 arrays that hold float32 numbers."""
    mesh = np.meshgrid(*axes, indexing="ij")
    return [a.ravel().astype(np.float32).astype(np.float64) for a in mesh]


def evaluate(root, term, *arguments):
    """The term, an expression of the components of x, at each of the arguments' values."""
    columns = np.zeros((1, len(arguments[0]), 4), np.float32)
    for i, argument in enumerate(arguments):
        columns[0, :, i] = argument
    return run(root, "brdf_terms.glsl", {"u_arguments": columns}, [Output("o_value")], {"TERM": term})[0][0, :, 0]


def run(root, file, inputs, outputs, defines):
    kernel = Kernel(str(root / KERNELS / file), tuple(outputs), {n: "FLOAT_2D" for n in inputs}, {}, defines)
    one = Pass(kernel)
    height, width = next(iter(inputs.values())).shape[:2]
    targets = [textures.empty(width, height, o.format) for o in outputs]
    one.run(targets, {name: textures.upload(value) for name, value in inputs.items()})
    result = [textures.download(target).astype(np.float64) for target in targets]
    one.close()
    return result


def assert_close(got, expected, relative, absolute=0.0):
    """Every value within a relative or an absolute bound (an array or a number); says where the worst one is."""
    assert np.isfinite(got).all()
    excess = np.abs(got - expected) - (relative * np.abs(expected) + absolute)
    worst = int(np.argmax(excess))
    assert excess.flat[worst] <= 0, f"at {worst}: {got.flat[worst]} instead of {expected.flat[worst]}"


def heads(theta):
    """n·h and sin² as float32 has them, and the angle that they describe."""
    cosine = np.cos(theta).astype(np.float32).astype(np.float64)
    sine2 = (np.sin(theta) ** 2).astype(np.float32).astype(np.float64)
    return cosine, sine2, np.arctan2(np.sqrt(sine2), cosine)


def test_d_beckmann_is_that_of_cook_and_torrance(root):
    theta, m = grid(THETAS, np.array([0.02, 0.05, 0.1, 0.3, 0.5, 0.8, 1.0]))
    cosine, sine2, seen = heads(theta)
    expected = oracles.beckmann(seen, m)
    # exp() of an argument x that is known to a few ulp is known to x times as many.
    condition = 1 + np.minimum(np.tan(seen) ** 2 / m**2, 100)
    got = evaluate(root, "D_Beckmann(x.x, x.y, x.z)", cosine, sine2, m)
    assert_close(got, expected, 8 * EPS * condition, 1e-30)


def test_d_ggx_keeps_its_digits_in_the_narrowest_lobe(root):
    theta, alpha = grid(THETAS, ALPHAS)
    cosine, sine2, seen = heads(theta)
    got = evaluate(root, "D_GGX(x.x, x.y, x.z)", cosine, sine2, alpha)
    assert_close(got, oracles.ggx(seen, alpha), 8 * EPS)


def test_v_smith_ggx_is_height_correlated_and_finite_at_grazing(root):
    light, view, alpha = grid(COSINES, COSINES, ALPHAS)
    expected = oracles.smith_ggx(light, view, alpha) / (4 * light * view)
    assert_close(evaluate(root, "V_SmithGGX(x.x, x.y, x.z)", light, view, alpha), expected, 12 * EPS)


def test_g_v_cavity_is_that_of_cook_and_torrance(root):
    light, view, half, between = grid(COSINES, COSINES, COSINES[3:], COSINES)
    expected = oracles.v_cavity(light, view, half, between)
    got = evaluate(root, "G_VCavity(x.x, x.y, x.z, x.w)", light, view, half, between)
    assert_close(got, expected, 4 * EPS)
    assert got.max() == 1


def test_f_schlick_goes_from_f0_to_one(root):
    cosine, f0 = grid(np.concatenate([[0.0], COSINES]), np.array([0.0, 0.02, 0.028, 0.04, 0.5, 1.0]))
    got = evaluate(root, "F_Schlick(x.x, x.y)", cosine, f0)
    # 1 − v·h is exact in float32; what is left is rounding.
    assert_close(got, oracles.schlick(cosine, f0), 6 * EPS)
    assert np.array_equal(got[cosine == 1], f0[cosine == 1])
    assert np.allclose(got[cosine == 0], 1, atol=EPS)


def test_f_dielectric_agrees_with_snell_and_the_two_polarisations(root):
    cosine, ior = grid(COSINES, np.array([1.0, 1.0001, 1.1, 1.33, 1.402, 1.5, 1.8, 2.5]))
    got = evaluate(root, "F_Dielectric(x.x, x.y)", cosine, ior)
    expected = np.where(ior > 1, oracles.dielectric(cosine, ior), 0)
    # ior² − 1 keeps what float32 kept of ior − 1, and F is proportional to its square.
    beyond = np.where(ior > 1, EPS * ior**2 / np.maximum(ior**2 - 1, EPS), 0)
    assert_close(got, expected, 16 * EPS + 4 * beyond, 1e-14)
    assert (got[ior == 1] == 0).all()


def test_ior_from_f0_returns_that_of_skin_and_glass(root):
    f0 = np.array([0.0, 0.028, 0.04, 0.08])
    got = evaluate(root, "ior_from_F0(x.x)", f0)
    assert np.allclose(got, [1, 1.402, 1.5, 1.7888], atol=2e-4)
    assert_close(got, oracles.ior_from_f0(f0.astype(np.float32).astype(float)), 4 * EPS)


def test_fd_lambert_is_the_cosine_and_zero_below(root):
    cosine = np.array([-1.0, -1e-6, 0.0, 1e-6, 0.5, 1.0], np.float32)
    assert np.array_equal(evaluate(root, "Fd_Lambert(x.x)", cosine), np.maximum(cosine, 0))


def test_the_specular_layer_takes_what_the_integral_says(root):
    view, roughness, f0 = grid(
        [1e-4, 0.03, 0.09, 0.25, 0.55, 0.8, 1.0], [0.02, 0.1, 0.3, 0.6, 1.0], [0.004, 0.04, 0.08]
    )
    got = evaluate(root, "E_SpecularLayer(x.x, x.y, x.z)", view, roughness, f0)
    integral = np.array([oracles.specular_layer_albedo(*row) for row in zip(view, roughness, f0, strict=True)])
    error = np.abs(got - integral)
    assert error[view > 0.089].max() < 0.005
    assert error.max() < 0.017
    assert error.mean() < 0.0015


def test_the_fit_of_the_specular_layer_is_the_same_in_the_oracle(root):
    view, roughness, f0 = grid(np.linspace(1e-4, 1, 60), np.linspace(0.02, 1, 40), [0.0, 0.001, 0.028, 0.04, 0.08])
    got = evaluate(root, "E_SpecularLayer(x.x, x.y, x.z)", view, roughness, f0)
    assert_close(got, oracles.specular_layer_fit(view, roughness, f0), 3e-5, 1e-7)


def test_the_coat_takes_and_gives_what_the_integrals_say(root):
    view, roughness, _ = grid([1e-3, 0.03, 0.09, 0.25, 0.55, 0.8, 1.0], [0.02, 0.1, 0.2, 0.3, 0.45, 0.6], [0.0])
    integral = np.array([oracles.coat_albedo(*row) for row in zip(view, roughness, strict=True)])
    gain = evaluate(root, "coat_gain(x.x, x.y)", view, roughness)
    albedo = evaluate(root, "E_Coat(x.x, x.y)", view, roughness)
    assert np.abs(gain - integral[:, 0]).max() < 0.002
    error = np.abs(albedo - integral[:, 1])
    assert error[view > 0.089].max() < 0.01
    assert error.max() < 0.02
    assert error.mean() < 0.003


def test_the_fit_of_the_coat_is_the_same_in_the_oracle(root):
    view, roughness, _ = grid(np.linspace(1e-4, 1, 60), np.linspace(0.02, 0.6, 40), [0.0])
    gain, albedo = oracles.coat_fit(view, roughness)
    assert_close(evaluate(root, "coat_gain(x.x, x.y)", view, roughness), gain, 4 * EPS)
    assert_close(evaluate(root, "E_Coat(x.x, x.y)", view, roughness), albedo, 3e-5, 1e-7)


def test_the_specular_layer_takes_four_percent_head_on_and_a_quarter_to_a_half_at_grazing(root):
    view = np.cos(np.radians([0, 80]))
    smooth = evaluate(root, "E_SpecularLayer(x.x, x.y, x.z)", view, [0.05, 0.05], [0.04, 0.04])
    rough = evaluate(root, "E_SpecularLayer(x.x, x.y, x.z)", view, [0.4, 0.4], [0.04, 0.04])
    assert np.allclose(smooth, [0.04, 0.388], atol=0.003)
    assert np.allclose(rough, [0.041, 0.23], atol=0.005)


@pytest.mark.parametrize(
    ("term", "widths"),
    [("D_Beckmann(x.x, x.y, x.z)", [0.02, 0.05, 0.2, 0.8]), ("D_GGX(x.x, x.y, x.z)", [4e-4, 0.01, 0.2, 1.0])],
)
def test_a_distribution_of_normals_has_a_projected_area_of_one(root, term, widths):
    nodes, weights = np.polynomial.legendre.leggauss(2000)
    for width in widths:
        # Substitute tan θ = width · q / (1 − q): half of the nodes lie within the lobe, whatever its width.
        q = (nodes + 1) / 2
        theta = np.arctan(width * q / (1 - q))
        slope = width / (1 - q) ** 2 * np.cos(theta) ** 2
        d = evaluate(root, term, np.cos(theta), np.sin(theta) ** 2, np.full_like(theta, width))
        area = np.sum(d * np.cos(theta) * np.sin(theta) * 2 * np.pi * slope * weights / 2)
        assert abs(area - 1) < 2e-6


def test_angles_hold_for_nearly_equal_and_nearly_opposite_directions(root):
    rng = np.random.default_rng(3)
    normal = np.tile([0.0, 0.0, 1.0], (4000, 1))
    light = oracles.unit(rng.normal(size=(4000, 3)))
    light[:, 2] = np.abs(light[:, 2])
    tilt = 10.0 ** rng.uniform(-7, 0, 4000)
    mirror = light * [-1, -1, 1]
    view = oracles.unit(mirror + tilt[:, None] * rng.normal(size=(4000, 3)))
    # A quarter of them face each other just above the horizon.
    low = slice(0, 1000)
    light[low, 2] = 10.0 ** rng.uniform(-6.5, -1, 1000)
    view[low] = light[low] * [-1, -1, 1] + [0, 0, 1e-6]
    light, view = oracles.unit(light).astype(np.float32), oracles.unit(view).astype(np.float32)
    keep = (light[:, 2] > 1.5e-7) & (view[:, 2] > 1.5e-7)
    inputs = {"u_normal_in": normal, "u_light_in": light, "u_view_in": view}
    outputs = [Output("o_value"), Output("o_sine")]
    value, sine = run(root, "brdf_angles.glsl", {k: a[None].astype(np.float32) for k, a in inputs.items()}, outputs, {})
    c = oracles.Configuration(normal, light.astype(np.float64), view.astype(np.float64))
    assert_close(value[0, keep, 2], c.half[keep], 8 * EPS)
    assert_close(value[0, keep, 3], c.between[keep], 8 * EPS)
    # With the normal along z, l + v is exact but for the rounding of each sum.
    total = light.astype(np.float64) + view
    rounding = EPS * np.abs(light[:, :2]).max(axis=1) / np.linalg.norm(total, axis=1)
    sine2 = np.sin(c.theta) ** 2
    assert_close(sine[0, keep, 0], sine2[keep], 8 * EPS, (2 * np.sqrt(sine2) * rounding + rounding**2)[keep])


def test_a_direction_on_the_horizon_counts_as_below_it(root):
    light, view = grid([-1.0, 0.0, 5e-8, 1.1e-7, 1.0], [-1.0, 0.0, 5e-8, 1.1e-7, 1.0])
    got = evaluate(root, "above_horizon(x.x, x.y) ? 1.0 : 0.0", light, view)
    assert np.array_equal(got, (light > 1e-7) & (view > 1e-7))
