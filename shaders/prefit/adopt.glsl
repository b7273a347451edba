// Over W×H texels: the estimates with the prefit's normal. Reads the estimates and u_prefit_0: those of the prefit's own
// model, whose first three components are its normal.

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
    write_estimate(c);
    return true;
}
