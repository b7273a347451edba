// Over W×H texels, in place: takes given bests at the texels that belong to a neighbouring tile.

#include "common/frame.glsl"

bool texel_kernel(ivec2 texel)
{
    if (state_at(texel) != TEXEL_HALO) {
        return false;
    }
    o_best_0 = texelFetch(u_given_0, texel, 0);
#if BLOCKS > 1
    o_best_1 = texelFetch(u_given_1, texel, 0);
#endif
    return true;
}
