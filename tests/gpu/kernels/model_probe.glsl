// Evaluates a model at the parameters in u_components and the directions in u_light_in, u_view_in.
// Writes VALUE, an expression of the material s, the light l and the view v, to o_value.

#include "material.glsl"
#include "model.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[MAX_COMPONENTS];
    read_components(texel, c);
    Material s = material_from(c);
    vec3 l = texelFetch(u_light_in, texel, 0).xyz;
    vec3 v = texelFetch(u_view_in, texel, 0).xyz;
    o_value = vec4(VALUE, 1.0);
    return true;
}
