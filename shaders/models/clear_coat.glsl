// A metallic–roughness material of IOR 1.5 under a clear coat, as Cycles renders Blender's Principled BSDF with
// distribution GGX, a white Specular Tint and a white Coat Tint. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney. For a given coat, radiance is linear in the base colour.

#include "brdf/e_coat.glsl"
#include "brdf/principled_layers.glsl"

// Returns π f_r n·l: x per unit of base colour, y independent of the base colour.
vec2 clear_coat_parts(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec2(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float lobe = ggx_lobe(a, s.roughness);
    float edge = grazing(l, v, a.VoH);
    float F = F_Dielectric(a.VoH, COAT_IOR); // base and coat have the same IOR
    float base = mix(layered_diffuse(a.NoL, a.NoV, s.roughness, F0_DEFAULT), lobe * (1.0 - edge), s.metallic);
    float fixed_part = lobe * mix(F, edge, s.metallic);
    float through = 1.0 - s.coat_weight * E_Coat(a.NoV, s.coat_roughness);
    float coat = ggx_lobe(a, s.coat_roughness) * F * coat_gain(a.NoV, s.coat_roughness);
    return vec2(base * through, fixed_part * through + s.coat_weight * coat);
}

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    return vec3(clear_coat_parts(s, l, v).x);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    return vec3(clear_coat_parts(s, l, v).y);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    vec2 parts = clear_coat_parts(s, l, v);
    return s.base_color * parts.x + parts.y;
}
