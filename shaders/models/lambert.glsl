// Lambert: radiance is albedo times n·l. See ../README.md for the contract of a model.

#include "brdf/fd_lambert.glsl"
#include "brdf/horizon.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    return vec3(above_horizon(NoL, dot(s.normal, v)) ? Fd_Lambert(NoL) : 0.0);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v);
}
