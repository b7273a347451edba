// Over W×H texels: decodes the global bests to materials. Reads the global bests, and the estimates for the parameters
// that are not searched. Writes the estimates.

#include "common/estimate.glsl"
#include "swarm/neighbours.glsl"
#include "particle_encoding.glsl"

bool texel_kernel(ivec2 texel)
{
    Material s = estimate_at(texel);
    if (state_at(texel) != TEXEL_OUTSIDE) {
        float best[MAX_DIMENSIONS];
        read_best(texel, best);
        decode(best, albedo_limit_of(radiance_scale_at(texel)), s);
    }
    float c[MAX_COMPONENTS];
    material_to(s, c);
    write_estimate(c);
    return true;
}
