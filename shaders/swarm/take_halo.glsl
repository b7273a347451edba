// Over W×H texels, in place: writes the bests of the halo, the texels of neighbouring tiles.

#include "common/frame.glsl"

bool texel_kernel(ivec2 texel)
{
    if (state_at(texel) != TEXEL_HALO) {
        return false;
    }
    float x[8];
    read_given(texel, x);
    write_best(x);
    return true;
}
