// The metallic–roughness workflow: a dielectric, diffuse under one GGX layer, mixed by ``metallic`` with a metal, whose
// GGX lobe has the base colour. As Blender's Principled BSDF with distribution GGX and a white Specular Tint renders it in
// Cycles. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney. Given metallic, radiance is linear in the base colour, though that is
// in two lobes: diffuse albedo of the one part and, by Schlick's Fresnel, what the other reflects face on.

#include "brdf/principled_layers.glsl"

// What one unit of base colour reflects, and what is reflected whatever the colour.
void metallic_roughness_parts(Material s, vec3 l, vec3 v, out float base, out float fixed_part)
{
    base = 0.0;
    fixed_part = 0.0;
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return;
    }
    Angles a = angles_of(s.normal, l, v);
    float F0 = F0_PER_LEVEL * s.specular;
    float lobe = ggx_lobe(a, s.roughness);
    float edge = grazing(l, v, a.VoH);
    base = mix(layered_diffuse(a.NoL, a.NoV, s.roughness, F0), lobe * (1.0 - edge), s.metallic);
    fixed_part = lobe * mix(F_Dielectric(a.VoH, ior_from_F0(F0)), edge, s.metallic);
}

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float base;
    float fixed_part;
    metallic_roughness_parts(s, l, v, base, fixed_part);
    return vec3(base);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    float base;
    float fixed_part;
    metallic_roughness_parts(s, l, v, base, fixed_part);
    return vec3(fixed_part);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    float base;
    float fixed_part;
    metallic_roughness_parts(s, l, v, base, fixed_part);
    return s.base_color * base + vec3(fixed_part);
}
