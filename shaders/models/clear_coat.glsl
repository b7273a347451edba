// A metallic–roughness material of IOR 1.5 under a clear coat, as Blender's Principled BSDF with distribution GGX, a white
// Specular Tint and a white Coat Tint renders it in Cycles. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney. Given the coat, radiance is linear in the base colour.

#include "brdf/e_coat.glsl"
#include "brdf/principled_layers.glsl"

// F0 at Blender's Specular IOR Level of 0.5.
#define CLEAR_COAT_BASE_F0 0.04

// What one unit of base colour reflects, and what is reflected whatever the colour.
void clear_coat_parts(Material s, vec3 l, vec3 v, out float base, out float fixed_part)
{
    base = 0.0;
    fixed_part = 0.0;
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return;
    }
    Angles a = angles_of(s.normal, l, v);
    float lobe = ggx_lobe(a, s.roughness);
    float edge = grazing(l, v, a.VoH);
    float F = F_Dielectric(a.VoH, COAT_IOR); // the base's IOR is the coat's
    base = mix(layered_diffuse(a.NoL, a.NoV, s.roughness, CLEAR_COAT_BASE_F0), lobe * (1.0 - edge), s.metallic);
    fixed_part = lobe * mix(F, edge, s.metallic);
    float through = 1.0 - s.coat_weight * E_Coat(a.NoV, s.coat_roughness);
    float coat = ggx_lobe(a, s.coat_roughness) * F * coat_gain(a.NoV, s.coat_roughness);
    base *= through;
    fixed_part = fixed_part * through + s.coat_weight * coat;
}

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float base;
    float fixed_part;
    clear_coat_parts(s, l, v, base, fixed_part);
    return vec3(base);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    float base;
    float fixed_part;
    clear_coat_parts(s, l, v, base, fixed_part);
    return vec3(fixed_part);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    float base;
    float fixed_part;
    clear_coat_parts(s, l, v, base, fixed_part);
    return s.base_color * base + vec3(fixed_part);
}
