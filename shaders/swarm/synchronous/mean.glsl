// Over W×H texels: computes the neighbourhood mean of Eq. 4 once for all particles of a synchronous swarm.

#include "swarm/neighbours.glsl"

bool texel_kernel(ivec2 texel)
{
    float mean[MAX_DIMENSIONS];
    for (int i = 0; i < MAX_DIMENSIONS; i++) {
        mean[i] = 0.0;
    }
    if (state_at(texel) == TEXEL_SOLVED) {
        neighbourhood_mean(texel, frame_at(texel), mean);
    }
    write_mean(mean);
    return true;
}
