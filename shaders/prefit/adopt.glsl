// Over W×H texels: the estimates with the normal that the prefit has found, packed as the estimates are.
// Reads the estimates and u_prefit_0: those of the prefit's own model, whose first three are its normal.

#include "common/estimate.glsl"
#include "common/frame.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[12];
    material_to(estimate_at(texel), c);
    if (state_at(texel) == TEXEL_SOLVED) {
        vec3 n = texelFetch(u_prefit_0, texel, 0).xyz;
        c[NORMAL_COMPONENT] = n.x;
        c[NORMAL_COMPONENT + 1] = n.y;
        c[NORMAL_COMPONENT + 2] = n.z;
    }
    o_estimate_0 = vec4(c[0], c[1], c[2], c[3]);
#if ESTIMATES > 1
    o_estimate_1 = vec4(c[4], c[5], c[6], c[7]);
#endif
#if ESTIMATES > 2
    o_estimate_2 = vec4(c[8], c[9], c[10], c[11]);
#endif
    return true;
}
