// Over W×H texels: detects indirect light. The light counts as indirect where the prefit fits the samples of a texel
// and its neighbours badly and they are brighter than the fit, because other surfaces add light. Reads u_measured
// (indirect_misfit.glsl) and the packing. Writes o_shadow: RAISED_SHADOW where the light is indirect, 0 elsewhere.

#include "prefit/around.glsl"

bool texel_kernel(ivec2 texel)
{
    o_shadow = 0.0;
    if (state_at(texel) == TEXEL_SOLVED && texelFetch(u_measured, texel, 0).z > 0.0) {
        vec4 sum = neighbourhood_sum(texel);
        if (sum.x > MIN_MISFIT * sum.w && sum.y > MIN_SURPLUS * sum.w) {
            o_shadow = RAISED_SHADOW;
        }
    }
    return true;
}
