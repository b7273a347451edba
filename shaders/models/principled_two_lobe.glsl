// Lambert plus two GGX lobes of perceptual roughness r1 (weight w) and r2 (weight 1 − w). The lobes are those of
// Blender's Principled BSDF, added to the base as in the paper. See ../README.md for the contract of a model.
// Walter, Marschner, Li & Torrance 2007, Microfacet Models for Refraction through Rough Surfaces.

#include "brdf/angles.glsl"
#include "brdf/d_ggx.glsl"
#include "brdf/f_schlick.glsl"
#include "brdf/fd_lambert.glsl"
#include "brdf/v_smith_ggx.glsl"

// Skin: ((n − 1) / (n + 1))² at n = 1.402.
#define F0_SKIN 0.028

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    return vec3(above_horizon(NoL, dot(s.normal, v)) ? Fd_Lambert(NoL) : 0.0);
}

float lobe_GGX(Angles a, float roughness)
{
    float alpha = roughness * roughness;
    return D_GGX(a.NoH, a.sin2_h, alpha) * V_SmithGGX(a.NoL, a.NoV, alpha);
}

// w moves radiance from the second lobe to the first.
vec3 basis_w(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float DV = lobe_GGX(a, s.r1) - lobe_GGX(a, s.r2);
    return vec3(3.14159265358979 * DV * F_Schlick(a.VoH, F0_SKIN) * a.NoL);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    return vec3(3.14159265358979 * lobe_GGX(a, s.r2) * F_Schlick(a.VoH, F0_SKIN) * a.NoL);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    // Not mix(): compilers turn it into x + w (y − x), which at w = 1 loses the tail of y in the rounding of x.
    float DV = s.w * lobe_GGX(a, s.r1) + (1.0 - s.w) * lobe_GGX(a, s.r2);
    return s.base_color * Fd_Lambert(a.NoL) + 3.14159265358979 * DV * F_Schlick(a.VoH, F0_SKIN) * a.NoL;
}
