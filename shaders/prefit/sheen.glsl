// Over W×H texels: selects the prefit with sheen (o_chosen = 1) where the first prefit fits a texel and its neighbours
// badly and the second is better by the fraction SHEEN_GAIN. Elsewhere o_chosen is 0. Reads u_measured (x, y: fitness
// of the first and the second prefit; z: 1 where both are valid) and the packing.

#include "prefit/around.glsl"

bool texel_kernel(ivec2 texel)
{
    o_chosen = 0.0;
    if (state_at(texel) == TEXEL_SOLVED && texelFetch(u_measured, texel, 0).z > 0.0) {
        vec4 sum = neighbourhood_sum(texel);
        if (sum.x > MIN_FITNESS * sum.z && sum.y < (1.0 - SHEEN_GAIN) * sum.x) {
            o_chosen = 1.0;
        }
    }
    return true;
}
