// Evaluates a model at the parameters in u_components_0 to u_components_2 and the directions in u_light_in, u_view_in.
// Writes VALUE, an expression of the material s, the light l and the view v, to o_value.

#include "material.glsl"
#include "model.glsl"

bool texel_kernel(ivec2 texel)
{
    vec4 c0 = texelFetch(u_components_0, texel, 0);
    vec4 c1 = texelFetch(u_components_1, texel, 0);
    vec4 c2 = texelFetch(u_components_2, texel, 0);
    float c[12];
    for (int i = 0; i < 4; i++) {
        c[i] = c0[i];
        c[4 + i] = c1[i];
        c[8 + i] = c2[i];
    }
    Material s = material_from(c);
    vec3 l = texelFetch(u_light_in, texel, 0).xyz;
    vec3 v = texelFetch(u_view_in, texel, 0).xyz;
    o_value = vec4(VALUE, 1.0);
    return true;
}
