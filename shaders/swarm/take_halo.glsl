// Over W×H texels, in place: copies the received global bests to the halo, texels that neighbouring tiles own.

#include "common/frame.glsl"

bool texel_kernel(ivec2 texel)
{
    if (state_at(texel) != TEXEL_HALO) {
        return false;
    }
    float received[MAX_DIMENSIONS];
    read_given(texel, received);
    write_best(received);
    return true;
}
