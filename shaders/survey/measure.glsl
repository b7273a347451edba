// Over W×H texels: how well the estimates explain a texel, on the judge's terms.

#include "common/estimate.glsl"
#include "swarm/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    o_fitness = UNFIT;
    if (state_at(texel) == TEXEL_SOLVED) {
        o_fitness = fitness_of(texel, frame_at(texel), estimate_at(texel));
    }
    return true;
}
