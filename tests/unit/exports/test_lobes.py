"""The Ward lobe of a texel against a search over widths, in float64 and without tables."""

from functools import partial

import numpy as np
import pytest

from irpso_addon.exports.lobes import fit_ward
from irpso_addon.exports.surface import Lobe, Surface
from tests.oracles import reflectance as oracles


def nearest_ward(view_angle, alpha, reflectances):
    """Return width and albedos of the Ward lobe nearest to a GGX lobe of several reflectances F(v·h), each by itself.

    The lobe is seen from one direction, and the squared difference is summed over the solid angle of all lights.
    """
    view = np.array([np.sin(view_angle), 0, np.cos(view_angle)])
    theta = np.arctan(np.geomspace(1e-4, 30, 900))[:, None]
    phi = (np.arange(180) + 0.5) * np.pi / 180
    half = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) * np.ones_like(phi)]
    half = np.stack(half, axis=-1)
    between = half @ view
    light = 2 * between * half[..., 2] - view[2]
    # dω of the light: 4 v·h dω of the half vector; the steps are even in log tan θ.
    weight = 4 * between * np.sin(theta) ** 2 * np.cos(theta)
    seen = (light > 1e-3) & (between > 1e-3)
    light, between, weight, cosine = light[seen], between[seen], weight[seen], half[..., 2][seen]
    lobe = oracles.ggx(np.arccos(cosine), alpha) * oracles.smith_ggx(light, view[2], alpha) / (4 * view[2])
    best = None
    for width in np.geomspace(0.5 * alpha, 2 * alpha, 120):
        ward = np.exp(-(1 / cosine**2 - 1) / width**2) * np.sqrt(light / view[2]) / (4 * np.pi * width**2)
        lobes = [lobe * f(between) for f in reflectances]
        albedos = [(weight * lobe * ward).sum() / (weight * ward**2).sum() for lobe in lobes]
        error = sum((weight * (shown - a * ward) ** 2).sum() for shown, a in zip(lobes, albedos, strict=True))
        if best is None or error < best[0]:
            best = error, width, albedos
    return best[1:]


def texel(tilt, alpha, base_color, f0, metallic):
    normal = np.float32([np.sin(tilt), 0, np.cos(tilt)]).reshape(1, 1, 3)
    one = np.ones((1, 1), np.float32)
    color = np.float32(base_color).reshape(1, 1, 3)
    return Surface(color, normal, (Lobe(one, alpha * one, "GGX"),), f0 * one, metallic * one, layered=True)


@pytest.mark.parametrize("tilt", [0, 30, 64, 70])
def test_a_metals_lobe_follows_its_own_fresnel_curve(tilt):
    color, alpha = (0.9, 0.6, 0.3), 0.09
    fit = fit_ward(texel(np.radians(tilt), alpha, color, 0.04, 1.0), 0.005, 1.0)
    width, albedos = nearest_ward(np.radians(tilt), alpha, [partial(oracles.schlick, f0=f0) for f0 in color])
    print(f"\nmetal tilted by {tilt}°: {fit.strength[0, 0]} of {np.round(albedos, 3)}")
    np.testing.assert_allclose(fit.strength[0, 0], albedos, rtol=0.04)
    np.testing.assert_allclose(fit.alpha[0, 0], width, rtol=0.03)


@pytest.mark.parametrize("level", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("tilt", [0, 60])
def test_a_dielectrics_lobe_follows_fresnel(tilt, level):
    f0, alpha = 0.08 * level, 0.09
    fit = fit_ward(texel(np.radians(tilt), alpha, (0.2, 0.2, 0.2), f0, 0.0), 0.005, 1.0)
    fresnel = partial(oracles.dielectric, ior=oracles.ior_from_f0(f0))
    _, (albedo,) = nearest_ward(np.radians(tilt), alpha, [fresnel])
    print(f"\nlevel {level}, tilt {tilt}°: {fit.strength[0, 0, 0]:.4f} of {albedo:.4f}")
    np.testing.assert_allclose(fit.strength[0, 0], albedo, rtol=0.25)
