// Material of a texel's global best with its linear weights; before the first generation the estimate. Reads u_best,
// u_best_linear and the estimates.

#include "basis.glsl"
#include "swarm/update.glsl"

Material material_of_best(ivec2 texel)
{
    Material s = estimate_at(texel);
#ifndef START
    float best[MAX_DIMENSIONS];
    float w[MAX_WEIGHTS];
    read_best(texel, best);
    read_best_linear(texel, w);
    decode(best, albedo_limit_of(radiance_scale_at(texel)), s);
    linear_from(w, s);
#endif
    return s;
}
