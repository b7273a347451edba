// Isotropic Ward. Ward 1992, Measuring and Modeling Anisotropic Reflection, Eq. 4.
// f = ρd/π + ρs exp(−tan²δ / α²) / (4π α² √(n·l n·v)), δ between n and the half vector.

#include "brdf/angles.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    return vec3(above_horizon(NoL, dot(s.normal, v)) ? NoL : 0.0);
}

vec3 basis_strength(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float a2 = s.slope * s.slope;
    return vec3(exp(-a.sin2_h / (a.NoH * a.NoH * a2)) / (4.0 * a2) * sqrt(a.NoL / a.NoV));
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v) + s.strength * basis_strength(s, l, v);
}
