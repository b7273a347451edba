// Principled with metals: a dielectric as models/principled.glsl has it, at Blender's default Specular IOR Level of 0.5,
// mixed by ``metallic`` with a metal, whose GGX lobe has the base colour. As Blender's Principled BSDF with distribution
// GGX and a white Specular Tint renders it in Cycles. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney. Given metallic, radiance is linear in the base colour, though that is
// in two lobes: diffuse albedo of the one part and, by Schlick's Fresnel, what the other reflects face on.

#include "brdf/principled_layers.glsl"

#define DIELECTRIC_F0 0.04 // ((ior − 1) / (ior + 1))² of ior = 1.5

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    float NoV = dot(s.normal, v);
    if (!above_horizon(NoL, NoV)) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float diffuse = layered_diffuse(NoL, NoV, s.roughness, DIELECTRIC_F0);
    return vec3(mix(diffuse, ggx_lobe(a, s.roughness) * (1.0 - grazing(l, v, a.VoH)), s.metallic));
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float F = mix(F_Dielectric(a.VoH, ior_from_F0(DIELECTRIC_F0)), grazing(l, v, a.VoH), s.metallic);
    return vec3(ggx_lobe(a, s.roughness) * F);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v) + basis_fixed(s, l, v);
}
