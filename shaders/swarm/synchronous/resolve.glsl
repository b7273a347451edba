// Over W×H texels: the material that the global bests and their linear weights stand for, packed as estimates.

#include "swarm/synchronous/incumbent.glsl"

bool texel_kernel(ivec2 texel)
{
    Material s = estimate_at(texel);
    if (state_at(texel) == TEXEL_SOLVED) {
        s = incumbent_at(texel);
    }
    float c[12];
    material_to(s, c);
    write_estimate(c);
    return true;
}
