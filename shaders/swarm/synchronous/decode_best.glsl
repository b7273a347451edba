// Over W×H texels: decodes the global bests and their linear weights to materials. Writes the estimates.

#include "swarm/synchronous/incumbent.glsl"

bool texel_kernel(ivec2 texel)
{
    Material s = estimate_at(texel);
    if (state_at(texel) == TEXEL_SOLVED) {
        s = material_of_best(texel);
    }
    float c[MAX_COMPONENTS];
    material_to(s, c);
    write_estimate(c);
    return true;
}
