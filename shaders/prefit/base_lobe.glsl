// Model of the first prefit: base and lobe. See ../README.md for the contract of a model.

#include "prefit/bases.glsl"

vec3 basis_base(Material s, vec3 l, vec3 v)
{
    return cosine_power(s, l, v);
}

vec3 basis_lobe(Material s, vec3 l, vec3 v)
{
    return ggx_lobe(s, l, v);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base * basis_base(s, l, v) + s.lobe * basis_lobe(s, l, v);
}
