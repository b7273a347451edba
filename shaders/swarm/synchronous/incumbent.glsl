// The material of a texel's global best, with its linear weights. Reads u_best and u_best_linear; before the first
// generation, the estimate.

#include "basis.glsl"
#include "swarm/update.glsl"

Material incumbent_at(ivec2 texel)
{
    Material s = estimate_at(texel);
#ifndef START
    float g[8];
    float w[8];
    read_best(texel, g);
    read_best_linear(texel, w);
    decode(g, reach_of(scale_at(texel)), s);
    linear_from(w, s);
#endif
    return s;
}
