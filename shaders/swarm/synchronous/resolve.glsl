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
    o_estimate_0 = vec4(c[0], c[1], c[2], c[3]);
#if ESTIMATES > 1
    o_estimate_1 = vec4(c[4], c[5], c[6], c[7]);
#endif
#if ESTIMATES > 2
    o_estimate_2 = vec4(c[8], c[9], c[10], c[11]);
#endif
    return true;
}
