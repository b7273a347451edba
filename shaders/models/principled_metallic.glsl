// Principled with metals: a dielectric as models/principled.glsl has it, at Blender's default Specular IOR Level of 0.5,
// mixed by ``metallic`` with a metal, whose GGX lobe has the base colour. As Blender's Principled BSDF with distribution
// GGX and a white Specular Tint renders it in Cycles. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney. Given metallic, radiance is linear in the base colour, though that is
// in two lobes: diffuse albedo of the one part and, by Schlick's Fresnel, what the other reflects face on.

#include "brdf/principled_layers.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    return vec3(base_and_fixed(s.normal, s.roughness, F0_DEFAULT, s.metallic, l, v).x);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    return vec3(base_and_fixed(s.normal, s.roughness, F0_DEFAULT, s.metallic, l, v).y);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    vec2 parts = base_and_fixed(s.normal, s.roughness, F0_DEFAULT, s.metallic, l, v);
    return s.base_color * parts.x + parts.y;
}
