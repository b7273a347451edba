// Over W×H texels: where the light is indirect. There the prefit explains the samples of the texel and its neighbours badly,
// and they are brighter than it: other surfaces add light. Reads u_measured (evidence.glsl) and the packing. Writes o_shadow: there
// RAISED_SHADOW, 0 elsewhere.

#include "prefit/around.glsl"

bool texel_kernel(ivec2 texel)
{
    o_shadow = 0.0;
    if (state_at(texel) == TEXEL_SOLVED && texelFetch(u_measured, texel, 0).z > 0.0) {
        vec4 sum = measured_around(texel);
        if (sum.x > LEAST_MISFIT * sum.w && sum.y > LEAST_SURPLUS * sum.w) {
            o_shadow = RAISED_SHADOW;
        }
    }
    return true;
}
