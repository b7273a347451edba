// Over W×H texels: where the prefit with sheen replaces the first one. There the first explains a texel and its neighbours
// badly, and the second by SHEEN_GAIN better. Reads u_measured (both fitnesses, 1 where both are measures) and the packing.
// Writes o_chosen: there 1, 0 elsewhere.

#include "prefit/around.glsl"

bool texel_kernel(ivec2 texel)
{
    o_chosen = 0.0;
    if (state_at(texel) == TEXEL_SOLVED && texelFetch(u_measured, texel, 0).z > 0.0) {
        vec4 sum = measured_around(texel);
        if (sum.x > LEAST_FITNESS * sum.z && sum.y < (1.0 - SHEEN_GAIN) * sum.x) {
            o_chosen = 1.0;
        }
    }
    return true;
}
