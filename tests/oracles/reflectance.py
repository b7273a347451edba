"""Oracle of the reflectance models: float64 numpy, written from the papers, independent of the shaders.

Vectors are (…, 3) unit arrays that broadcast against each other. A model takes parameter name → array of shape (…,) or
(…, components), the incident and the view direction. It returns (…, 3) radiance under a light of intensity 1
(irradiance π at normal incidence): π f_r max(n·l, 0).
"""

from __future__ import annotations

import numpy as np

F0_SKIN = 0.028


def dot(a, b):
    """Return (…), the inner product over the last axis."""
    return np.sum(np.asarray(a, np.float64) * b, axis=-1)


def unit(a):
    """Return (…, 3) vectors of length 1."""
    a = np.asarray(a, np.float64)
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def beckmann(theta, m):
    """D of Beckmann & Spizzichino 1963 at the angle ``theta`` from the normal; ∫ D cos θ dω = 1."""
    return np.exp(-((np.tan(theta) / m) ** 2)) / (np.pi * m**2 * np.cos(theta) ** 4)


def ggx(theta, alpha):
    """D of Walter et al. 2007 Eq. 33; ∫ D cos θ dω = 1."""
    return 1 / (np.pi * np.cos(theta) ** 4 * (alpha + np.tan(theta) ** 2 / alpha) ** 2)


def smith_ggx(cos_light, cos_view, alpha):
    """Height-correlated G of Heitz 2014 Eq. 99 with Λ of Eq. 72."""

    def spread(cosine):
        return (np.sqrt(1 + alpha**2 * (1 - cosine**2) / cosine**2) - 1) / 2

    return 1 / (1 + spread(cos_light) + spread(cos_view))


def v_cavity(cos_light, cos_view, cos_half, cos_between):
    """G of Cook & Torrance 1982 Eq. 9; ``cos_between`` is v·h."""
    masking = 2 * cos_half * cos_view / cos_between
    shadowing = 2 * cos_half * cos_light / cos_between
    return np.minimum(1, np.minimum(masking, shadowing))


def schlick(cosine, f0):
    """F of Schlick 1994 Eq. 15."""
    return f0 + (1 - f0) * (1 - cosine) ** 5


def dielectric(cosine, ior):
    """F of Fresnel 1823: the mean of both polarisations, by Snell's law."""
    refracted = np.sqrt(1 - (1 - np.asarray(cosine) ** 2) / ior**2)
    s = (cosine - ior * refracted) / (cosine + ior * refracted)
    p = (ior * cosine - refracted) / (ior * cosine + refracted)
    return (s**2 + p**2) / 2


def ior_from_f0(f0):
    """Return the index of refraction with reflectance ``f0`` at normal incidence."""
    return (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))


def visible_normals(cos_view, alpha, steps=200):
    """Return quadrature nodes over the visible normals: v·h and n·l of the mirrored view, (S, S) each, and their mean.

    The nodes are uniform on spherical caps: Dupuy & Benyoub 2023, Sampling Visible GGX Normals with Spherical Caps.
    """
    view = np.array([np.sqrt(1 - cos_view**2), 0, cos_view])
    stretched = unit(view * [alpha, alpha, 1])
    nodes, weights = np.polynomial.legendre.leggauss(steps)
    z = (1 - (nodes + 1) / 2) * (1 + stretched[2]) - stretched[2]
    phi = (np.arange(steps) + 0.5) / steps * 2 * np.pi
    radius = np.sqrt(1 - z**2)[:, None]
    cap = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.broadcast_to(z[:, None], (steps, steps))], axis=-1)
    half = unit((cap + stretched) * [alpha, alpha, 1])
    cosine = np.clip(half @ view, 0, 1)
    return cosine, 2 * cosine * half[..., 2] - cos_view, lambda value: value.mean(axis=1) @ (weights / 2)


def specular_layer_albedo(cos_view, roughness, f0):
    """Albedo of the specular layer of Cycles' Principled for one view: A = F0 + (1 − F0) E[s], over visible normals.

    s = (F(v·h) − F0) / (1 − F0) where the mirrored view is above the horizon, else 0.
    """
    cosine, light, mean = visible_normals(cos_view, roughness**2)
    s = (dielectric(cosine, ior_from_f0(f0)) - f0) / (1 - f0) * (light > 0)
    return f0 + (1 - f0) * mean(s)


def specular_layer_fit(cos_view, roughness, f0):
    """The shader's fit to ``specular_layer_albedo``: F at a cosine that a rational function of m, r and F0 gives."""
    m, r = cos_view, roughness
    above = -0.4183 * m + 0.8193 * m**2 - 8.231 * m**3 + 5.514 * r * m + 3.45 * r * m**2
    above = above + 1.336 * r**2 - 4.016 * r**2 * m - 0.8463 * r**3
    below = r + 3.508 * m + 3.157 * m**2 + 0.3903 * r * m + 0.7437 * r**2
    squared = m**2 + r**2 * above / below * (f0 + 0.004179) / (f0 + 0.007262)
    return dielectric(np.sqrt(np.clip(squared, 0, 1)), ior_from_f0(f0))


def ggx_albedo(cos_view, roughness):
    """∫ D V n·l dω of a GGX lobe without Fresnel: its single-scattering albedo."""
    alpha = roughness**2
    _, light, mean = visible_normals(cos_view, alpha)
    up, seen = light > 0, smith_ggx(1.0, cos_view, alpha)
    return mean(np.where(up, smith_ggx(np.where(up, light, 1), cos_view, alpha) / seen, 0))


def coat_returned(roughness, lost=None):
    """Fms of Kulla & Conty 2017 for IOR 1.5. lost: 1 − the cosine-weighted mean albedo; None integrates it."""
    if lost is None:
        nodes, weights = np.polynomial.legendre.leggauss(24)
        cosines = (nodes + 1) / 2
        lost = 1 - sum(w * c * ggx_albedo(c, roughness) for w, c in zip(weights, cosines, strict=True))
    f = 0.5 / (4.08567 + 1.00071 * 1.5)
    return f * (1 - lost) / (1 - f * lost)


def coat_albedo(cos_view, roughness):
    """Return (gain, albedo) of Cycles' coat, integrated; gain: of its lobe, by multiple scattering."""
    albedo = ggx_albedo(cos_view, roughness)
    gain = 1 + coat_returned(roughness) * (1 - albedo) / albedo
    return gain, gain * albedo * specular_layer_albedo(cos_view, roughness, 0.04)


def coat_fit(cos_view, roughness):
    """The shader's fits to ``coat_albedo``: a rational function of n·v and α for E, a polynomial for its mean."""
    m, r = np.asarray(cos_view), np.asarray(roughness)
    a = r**2
    lost = 0.1945 * a * m - 0.428 * a * m**2 + 0.1761 * a * m**3 + 0.0234 * a**2 + 0.9081 * a**2 * m
    once = 1 - (lost + 0.77 * a**2 * m**2) / (m**2 - 0.2457 * a * m + 1.6195 * a**2)
    returned = coat_returned(r, 0.5947 * r**3 + 1.0653 * r**4 - 1.486 * r**6)
    gain = 1 + returned * (1 - once) / once
    return gain, gain * once * specular_layer_fit(m, r, 0.04)


class Configuration:
    """The cosines of a normal, a light and a view, and ``seen``: both above the horizon (elsewhere cosines are 1)."""

    def __init__(self, normal, light, view):
        normal, light, view = (np.asarray(a, np.float64) for a in (normal, light, view))
        self.light, self.view = dot(normal, light), dot(normal, view)
        self.seen = (self.light > 0) & (self.view > 0)
        total = light + view
        length = np.where(self.seen, np.linalg.norm(total, axis=-1), 2)
        self.half = np.where(self.seen, (self.light + self.view) / length, 1)
        self.between = np.where(self.seen, length / 2, 1)
        # atan2, because arccos loses half the digits of a small angle.
        across = np.linalg.norm(np.cross(normal, total), axis=-1)
        self.theta = np.where(self.seen, np.arctan2(across, self.light + self.view), 0)
        self.light, self.view = np.where(self.seen, self.light, 1), np.where(self.seen, self.view, 1)


def lambert(p, light, view):
    """π f n·l of a Lambertian surface: base_color, normal."""
    c = Configuration(p["normal"], light, view)
    return p["base_color"] * np.where(c.seen, c.light, 0)[..., None]


def principled(p, light, view, albedo=specular_layer_fit):
    """Blender's Principled with distribution GGX: base_color, normal, roughness, specular.

    albedo: ``specular_layer_fit``, the shader's, or a function with its signature.
    """
    c = Configuration(p["normal"], light, view)
    f0, alpha = 0.08 * np.asarray(p["specular"]), np.asarray(p["roughness"]) ** 2
    diffuse = p["base_color"] * (c.light * (1 - albedo(c.view, p["roughness"], f0)))[..., None]
    g = smith_ggx(c.light, c.view, alpha)
    specular = np.pi * ggx(c.theta, alpha) * g * dielectric(c.between, ior_from_f0(f0)) / (4 * c.view)
    return np.where(c.seen[..., None], diffuse + specular[..., None], 0)


def principled_metallic(p, light, view):
    """``metallic_roughness`` at a Specular IOR Level of 0.5: base_color, normal, roughness, metallic."""
    return metallic_roughness({**p, "specular": np.full(np.shape(p["roughness"]), 0.5)}, light, view)


def metallic_roughness(p, light, view):
    """Blender's Principled with distribution GGX and a white Specular Tint: a mixture.

    base_color, normal, roughness, metallic, specular. The metal's F82 tint model (Kutz, Hasan and Edmondson 2021) with
    a white tint is Schlick's.
    """
    c = Configuration(p["normal"], light, view)
    metallic = np.asarray(p["metallic"])[..., None]
    dielectric_part = principled(p, light, view)
    alpha = np.asarray(p["roughness"]) ** 2
    lobe = np.pi * ggx(c.theta, alpha) * smith_ggx(c.light, c.view, alpha) / (4 * c.view)
    fresnel = p["base_color"] + (1 - p["base_color"]) * ((1 - c.between) ** 5)[..., None]
    metal = np.where(c.seen[..., None], lobe[..., None] * fresnel, 0)
    return (1 - metallic) * dielectric_part + metallic * metal


def clear_coat(p, light, view, coat=coat_fit):
    """A coat over ``principled_metallic``: its parameters, coat_weight and coat_roughness.

    coat: ``coat_fit``, the shader's, or a function with its signature.
    """
    c = Configuration(p["normal"], light, view)
    weight, alpha = np.asarray(p["coat_weight"]), np.asarray(p["coat_roughness"]) ** 2
    gain, albedo = coat(c.view, p["coat_roughness"])
    lobe = np.pi * ggx(c.theta, alpha) * smith_ggx(c.light, c.view, alpha) * dielectric(c.between, 1.5) / (4 * c.view)
    base = principled_metallic(p, light, view) * (1 - weight * albedo)[..., None]
    return base + np.where(c.seen, weight * gain * lobe, 0)[..., None]


def grain(normal, rotation):
    """Tangent and bitangent (…, 3) of a normal: x projected to its plane, rotated by ``rotation`` full turns."""
    normal = np.asarray(normal, np.float64)
    x = np.array([1.0, 0, 0])
    along = unit(x - dot(normal, x)[..., None] * normal)
    across = np.cross(normal, along)
    cosine, sine = np.cos(2 * np.pi * rotation)[..., None], np.sin(2 * np.pi * rotation)[..., None]
    return cosine * along + sine * across, cosine * across - sine * along


def brushed(p, light, view, anisotropic, rotation):
    """Blender's Principled with distribution GGX by its own Anisotropic and Anisotropic Rotation.

    base_color, normal, roughness, metallic. Burley 2012 for D; Λ of Heitz 2014 Eq. 72 with the roughness in the
    direction's azimuth (Eq. 80), Eq. 99.
    """
    c = Configuration(p["normal"], light, view)
    aspect, square = np.sqrt(1 - 0.9 * anisotropic), np.asarray(p["roughness"]) ** 2
    wide, narrow = np.minimum(square / aspect, 1), square * aspect
    along, across = grain(p["normal"], rotation)

    def spread(direction, cosine):
        squared = (wide * dot(along, direction)) ** 2 + (narrow * dot(across, direction)) ** 2
        return (np.sqrt(1 + squared / cosine**2) - 1) / 2

    azimuth = np.arctan2(dot(across, light + view), dot(along, light + view))
    slope = np.tan(c.theta) ** 2 * ((np.cos(azimuth) / wide) ** 2 + (np.sin(azimuth) / narrow) ** 2)
    d = 1 / (np.pi * wide * narrow * np.cos(c.theta) ** 4 * (1 + slope) ** 2)
    lobe = np.pi * d / (1 + spread(light, c.light) + spread(view, c.view)) / (4 * c.view)
    diffuse = c.light * (1 - specular_layer_fit(c.view, (wide * narrow) ** 0.25, 0.04))
    metallic, colour = np.asarray(p["metallic"])[..., None], p["base_color"]
    paint = colour * diffuse[..., None] + (lobe * dielectric(c.between, 1.5))[..., None]
    metal = lobe[..., None] * (colour + (1 - colour) * ((1 - c.between) ** 5)[..., None])
    return np.where(c.seen[..., None], (1 - metallic) * paint + metallic * metal, 0)


def anisotropic(p, light, view):
    """``brushed`` by the cosine and the sine of twice the grain's angle: stretch and slant."""
    strength = np.minimum(np.hypot(p["stretch"], p["slant"]), 1)
    return brushed(p, light, view, strength, np.arctan2(p["slant"], p["stretch"]) / (4 * np.pi))


def cook_torrance_two_lobe(p, light, view):
    """The paper's model: base_color, normal, r1, r2 (Beckmann m), w (weight of r1)."""
    c = Configuration(p["normal"], light, view)
    d = p["w"] * beckmann(c.theta, p["r1"]) + (1 - p["w"]) * beckmann(c.theta, p["r2"])
    g = v_cavity(c.light, c.view, c.half, c.between)
    specular = np.pi * d * g * schlick(c.between, F0_SKIN) / (4 * c.view)
    return np.where(c.seen[..., None], p["base_color"] * c.light[..., None] + specular[..., None], 0)


def principled_two_lobe(p, light, view):
    """Two GGX lobes over Lambert: base_color, normal, r1, r2 (perceptual, α = r²), w (weight of r1)."""
    c = Configuration(p["normal"], light, view)

    def lobe(roughness):
        alpha = np.asarray(roughness) ** 2
        return ggx(c.theta, alpha) * smith_ggx(c.light, c.view, alpha)

    lobes = p["w"] * lobe(p["r1"]) + (1 - p["w"]) * lobe(p["r2"])
    specular = np.pi * lobes * schlick(c.between, F0_SKIN) / (4 * c.view)
    return np.where(c.seen[..., None], p["base_color"] * c.light[..., None] + specular[..., None], 0)


def ward(p, light, view):
    """Isotropic Ward 1992 Eq. 4: base_color, normal, strength, slope."""
    c = Configuration(p["normal"], light, view)
    gloss = np.exp(-((np.tan(c.theta) / p["slope"]) ** 2)) / (4 * np.pi * p["slope"] ** 2 * np.sqrt(c.light * c.view))
    specular = np.pi * p["strength"] * gloss * c.light
    return np.where(c.seen[..., None], p["base_color"] * c.light[..., None] + specular[..., None], 0)


def oren_nayar(p, light, view):
    """Oren & Nayar 1994 Eq. 30, from angles: base_color, normal, sigma."""
    c = Configuration(p["normal"], light, view)
    normal = np.asarray(p["normal"], np.float64)
    theta_l, theta_v = np.arccos(np.clip(c.light, 0, 1)), np.arccos(np.clip(c.view, 0, 1))
    flat_l = light - dot(normal, light)[..., None] * normal
    flat_v = view - dot(normal, view)[..., None] * normal
    lengths = np.linalg.norm(flat_l, axis=-1) * np.linalg.norm(flat_v, axis=-1)
    cos_phi = np.where(lengths > 0, dot(flat_l, flat_v) / np.where(lengths > 0, lengths, 1), 0)
    s2 = np.asarray(p["sigma"]) ** 2
    a, b = 1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    steep, flat = np.maximum(theta_l, theta_v), np.minimum(theta_l, theta_v)
    shade = a + b * np.maximum(0, cos_phi) * np.sin(steep) * np.tan(flat)
    return p["base_color"] * np.where(c.seen, c.light * shade, 0)[..., None]


def blinn_phong(p, light, view):
    """The model of shaders/README.md: base_color, normal, strength, slope (Akenine-Möller et al. 2008, Sec. 7.6)."""
    c = Configuration(p["normal"], light, view)
    power = 2 / np.asarray(p["slope"]) ** 2 - 2
    gloss = p["strength"] * (power + 8) / 8 * np.cos(c.theta) ** power * c.light
    return np.where(c.seen[..., None], p["base_color"] * c.light[..., None] + gloss[..., None], 0)


def base_lobe(p, light, view):
    """The prefit's model: base · (n·l)^cosine_exponent plus lobe · GGX without Fresnel; both are grey."""
    c = Configuration(p["normal"], light, view)
    alpha = np.asarray(p["roughness"]) ** 2
    lobe = np.pi * ggx(c.theta, alpha) * smith_ggx(c.light, c.view, alpha) / (4 * c.view)
    grey = np.where(c.seen, p["base"] * c.light ** p["cosine_exponent"] + p["lobe"] * lobe, 0)
    return np.repeat(grey[..., None], 3, axis=-1)


MODELS = {
    "blinn_phong": blinn_phong,
    "base_lobe": base_lobe,
    "lambert": lambert,
    "principled": principled,
    "principled_metallic": principled_metallic,
    "metallic_roughness": metallic_roughness,
    "clear_coat": clear_coat,
    "anisotropic": anisotropic,
    "cook_torrance_two_lobe": cook_torrance_two_lobe,
    "principled_two_lobe": principled_two_lobe,
    "ward": ward,
    "oren_nayar": oren_nayar,
}
