// Principled: a diffuse base under one dielectric GGX layer, as Blender's Principled BSDF with distribution GGX renders
// it in Cycles. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney; Burley 2015, Extending the Disney BRDF to a BSDF.

#include "brdf/angles.glsl"
#include "brdf/d_ggx.glsl"
#include "brdf/e_specular.glsl"
#include "brdf/f_dielectric.glsl"
#include "brdf/fd_lambert.glsl"
#include "brdf/v_smith_ggx.glsl"

// Blender's Specular IOR Level doubles F0 at 1 and leaves it at 0.5: F0 = 2 level ((ior − 1) / (ior + 1))², ior = 1.5.
#define F0_PER_LEVEL 0.08

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    float NoV = dot(s.normal, v);
    if (!above_horizon(NoL, NoV)) {
        return vec3(0.0);
    }
    return vec3(Fd_Lambert(NoL) * (1.0 - E_SpecularLayer(NoV, s.roughness, F0_PER_LEVEL * s.specular)));
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float alpha = s.roughness * s.roughness;
    float DV = D_GGX(a.NoH, a.sin2_h, alpha) * V_SmithGGX(a.NoL, a.NoV, alpha);
    float F = F_Dielectric(a.VoH, ior_from_F0(F0_PER_LEVEL * s.specular));
    return vec3(3.14159265358979 * DV * F * a.NoL);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v) + basis_fixed(s, l, v);
}
