// Over W×H texels: copies the prefit's normal to the estimates. Reads the estimates and u_prefit_0, whose first three
// components are the normal of the prefit's model.

#include "common/estimate.glsl"
#include "common/frame.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[MAX_COMPONENTS];
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
