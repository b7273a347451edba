// Lambert: radiance is albedo times the cosine. See ../README.md for the contract of a model.

#include "brdf/fd_lambert.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    return vec3(Fd_Lambert(dot(s.normal, l)));
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v);
}
