// The paper's model: Lambert plus two Cook–Torrance lobes of Beckmann slopes r1 (weight w) and r2 (weight 1 − w).
// See ../README.md for the contract of a model.
// Cook & Torrance 1982, A Reflectance Model for Computer Graphics, with Schlick's Fresnel term.

#include "brdf/angles.glsl"
#include "brdf/d_beckmann.glsl"
#include "brdf/f_schlick.glsl"
#include "brdf/fd_lambert.glsl"
#include "brdf/g_v_cavity.glsl"

// Skin: ((n − 1) / (n + 1))² at n = 1.402.
#define F0_SKIN 0.028

// Diffuse and specular reflection add up, as in the paper: the lobes do not attenuate the base.
vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    return vec3(above_horizon(NoL, dot(s.normal, v)) ? Fd_Lambert(NoL) : 0.0);
}

// Returns π f_r n·l / D of one lobe, with f_r = D F G / (4 n·l n·v). Cook & Torrance's Eq. 1 has π in place of 4. Their
// D lacks the factor 1/π, with which ∫ D (n·h) dω = 1.
float cook_torrance_over_D(Angles a)
{
    // n·l cancels. As n·v goes to 0, G is proportional to n·v, so G / n·v has a finite limit.
    float G = G_VCavity(a.NoL, a.NoV, a.NoH, a.VoH);
    return 0.25 * 3.14159265358979 * F_Schlick(a.VoH, F0_SKIN) * (G / a.NoV);
}

// w moves radiance from the second lobe to the first.
vec3 basis_w(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float D = D_Beckmann(a.NoH, a.sin2_h, s.r1) - D_Beckmann(a.NoH, a.sin2_h, s.r2);
    return vec3(D * cook_torrance_over_D(a));
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    return vec3(D_Beckmann(a.NoH, a.sin2_h, s.r2) * cook_torrance_over_D(a));
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    // Not mix(): compilers turn it into x + w (y − x), which at w = 1 loses the tail of y in the rounding of x.
    float D = s.w * D_Beckmann(a.NoH, a.sin2_h, s.r1) + (1.0 - s.w) * D_Beckmann(a.NoH, a.sin2_h, s.r2);
    return s.base_color * Fd_Lambert(a.NoL) + D * cook_torrance_over_D(a);
}
