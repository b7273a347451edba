// Over W×H texels: the neighbourhood mean of Eq. 4, once for all particles of a swarm that move together.

#include "swarm/neighbours.glsl"

bool texel_kernel(ivec2 texel)
{
    float mean[8];
    for (int i = 0; i < 8; i++) {
        mean[i] = 0.0;
    }
    if (state_at(texel) == TEXEL_SOLVED) {
        neighbourhood_mean(texel, frame_at(texel), mean);
    }
    o_mean_0 = vec4(mean[0], mean[1], mean[2], mean[3]);
#if BLOCKS > 1
    o_mean_1 = vec4(mean[4], mean[5], mean[6], mean[7]);
#endif
    return true;
}
