// Principled: a diffuse base under one dielectric GGX layer, as Cycles renders Blender's Principled BSDF with
// distribution GGX. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney; Burley 2015, Extending the Disney BRDF to a BSDF.

#include "brdf/principled_layers.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    return vec3(base_and_fixed(s.normal, s.roughness, F0_PER_LEVEL * s.specular, 0.0, l, v).x);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    return vec3(base_and_fixed(s.normal, s.roughness, F0_PER_LEVEL * s.specular, 0.0, l, v).y);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    vec2 parts = base_and_fixed(s.normal, s.roughness, F0_PER_LEVEL * s.specular, 0.0, l, v);
    return s.base_color * parts.x + parts.y;
}
