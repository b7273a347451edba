// Principled: a diffuse base under one dielectric GGX layer, as Blender's Principled BSDF with distribution GGX renders
// it in Cycles. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney; Burley 2015, Extending the Disney BRDF to a BSDF.

#include "brdf/principled_layers.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    float NoV = dot(s.normal, v);
    if (!above_horizon(NoL, NoV)) {
        return vec3(0.0);
    }
    return vec3(layered_diffuse(NoL, NoV, s.roughness, F0_PER_LEVEL * s.specular));
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    return vec3(ggx_lobe(a, s.roughness) * F_Dielectric(a.VoH, ior_from_F0(F0_PER_LEVEL * s.specular)));
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v) + basis_fixed(s, l, v);
}
