// The metallic–roughness workflow: ``metallic`` mixes a dielectric (diffuse under one GGX layer) with a metal, whose
// GGX lobe has the base colour. It matches Cycles' render of Blender's Principled BSDF with distribution GGX and a
// white Specular Tint. See ../README.md for the contract of a model. Burley 2012, Physically-Based Shading at Disney.
// For a given metallic, radiance is linear in the base colour, which occurs in two lobes: as the dielectric's albedo
// and, by Schlick's Fresnel, as the metal's reflectance at normal incidence.

#include "brdf/principled_layers.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    return vec3(base_and_fixed(s.normal, s.roughness, F0_PER_LEVEL * s.specular, s.metallic, l, v).x);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    return vec3(base_and_fixed(s.normal, s.roughness, F0_PER_LEVEL * s.specular, s.metallic, l, v).y);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    vec2 parts = base_and_fixed(s.normal, s.roughness, F0_PER_LEVEL * s.specular, s.metallic, l, v);
    return s.base_color * parts.x + parts.y;
}
