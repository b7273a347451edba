// Model of the second prefit, used where the first fits badly: base, lobe, and the sheen of fibres at grazing angles.
// Estevez & Kulla 2017, Production Friendly Microfacet Sheen BRDF: D ∝ sinᵏ θ_h, here with k = 1 / 0.35; Neubelt &
// Pettineo 2013, Crafting a Next-Gen Material Pipeline for The Order: 1886: V = 1 / (4 (n·l + n·v − n·l n·v)).

#include "prefit/bases.glsl"

#define SHEEN_POWER (0.5 / 0.35) // k / 2, the power of sin² θ_h

vec3 basis_base(Material s, vec3 l, vec3 v)
{
    return cosine_power(s, l, v);
}

vec3 basis_lobe(Material s, vec3 l, vec3 v)
{
    return ggx_lobe(s, l, v);
}

vec3 basis_sheen(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float denominator = a.NoL + a.NoV - a.NoL * a.NoV;
    return vec3((1.0 + SHEEN_POWER) * pow(a.sin2_h, SHEEN_POWER) * a.NoL / (4.0 * denominator));
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base * basis_base(s, l, v) + s.lobe * basis_lobe(s, l, v) + s.sheen * basis_sheen(s, l, v);
}
