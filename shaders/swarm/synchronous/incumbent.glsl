// The material that a texel's global best stands for, linear weights and all.
// Reads u_best_0, u_best_1, u_best_linear_0, u_best_linear_1; before the first generation there is only the estimate.

#include "basis.glsl"
#include "swarm/update.glsl"

Material incumbent_at(ivec2 texel)
{
    Material s = estimate_at(texel);
#ifndef START
    float g[8];
    read_best(texel, g);
    decode(g, reach_of(scale_at(texel)), s);
#if LINEAR_BLOCKS > 0
    float w[8];
    vec4 part = texelFetch(u_best_linear_0, texel, 0);
    for (int i = 0; i < 4; i++) {
        w[i] = part[i];
    }
#if LINEAR_BLOCKS > 1
    part = texelFetch(u_best_linear_1, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        w[4 + i] = part[i];
    }
    linear_from(w, s);
#endif
#endif
    return s;
}
