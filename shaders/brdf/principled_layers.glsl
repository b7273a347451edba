// Parts of Blender's Principled BSDF with distribution GGX and a white Specular Tint, as Cycles renders them: a diffuse
// base under a dielectric GGX layer, and a metal. Burley 2012, Physically-Based Shading at Disney.

#include "brdf/angles.glsl"
#include "brdf/d_ggx.glsl"
#include "brdf/e_specular.glsl"
#include "brdf/f_dielectric.glsl"
#include "brdf/fd_lambert.glsl"
#include "brdf/v_smith_ggx.glsl"

// Blender's Specular IOR Level doubles F0 at 1 and leaves it at 0.5: F0 = 2 level ((ior − 1) / (ior + 1))², ior = 1.5.
#define F0_PER_LEVEL 0.08
#define F0_DEFAULT 0.04 // level 0.5

// Returns (1 − v·h)⁵, Schlick's (1994) increase toward white at grazing angles. A black metal reflects only this, so it
// must be precise: 1 − v·h = sin² / (1 + v·h) with sin² = |l − v|² / 4 does not cancel where l and v are nearly equal.
float grazing(vec3 l, vec3 v, float VoH)
{
    vec3 l_minus_v = l - v;
    float m = 0.25 * dot(l_minus_v, l_minus_v) / (1.0 + VoH);
    float m2 = m * m;
    return m2 * m2 * m;
}

// Returns π D V n·l: the lobe of perfectly reflecting microfacets.
float ggx_lobe(Angles a, float roughness)
{
    float alpha = roughness * roughness;
    return 3.14159265358979 * D_GGX(a.NoH, a.sin2_h, alpha) * V_SmithGGX(a.NoL, a.NoV, alpha) * a.NoL;
}

// Returns π f_r n·l of a diffuse base under a layer of this F0, per unit of base colour.
float layered_diffuse(float NoL, float NoV, float roughness, float F0)
{
    return Fd_Lambert(NoL) * (1.0 - E_SpecularLayer(NoV, roughness, F0));
}

// A dielectric of this F0 (diffuse under a layer), mixed with a metal whose lobe has the base colour. Returns π f_r
// n·l: x per unit of base colour, y independent of the base colour.
vec2 base_and_fixed(vec3 normal, float roughness, float F0, float metallic, vec3 l, vec3 v)
{
    if (!above_horizon(dot(normal, l), dot(normal, v))) {
        return vec2(0.0);
    }
    Angles a = angles_of(normal, l, v);
    float lobe = ggx_lobe(a, roughness);
    float edge = grazing(l, v, a.VoH);
    float base = mix(layered_diffuse(a.NoL, a.NoV, roughness, F0), lobe * (1.0 - edge), metallic);
    return vec2(base, lobe * mix(F_Dielectric(a.VoH, ior_from_F0(F0)), edge, metallic));
}
