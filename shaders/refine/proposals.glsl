// Common code of the passes that try other materials (proposals): propagate.glsl, materials/propose.glsl. Reads
// u_status.

#include "refine/status.glsl"
#include "refine/neighbour_support.glsl"

// Returns whether a proposal may replace the texel's material and be refined. A proposal that is not refined yet has
// the linear weights of another texel, so its fitness is a weak measure. Much support is sufficient.
bool is_worth_refining(float fitness, float own_fitness, float support, float own_support)
{
    return fitness < CANDIDATE_RATIO * own_fitness || support > SUPPORT_RATIO * (1.0 + own_support);
}

// Writes the texel's own material, with the status of a converged texel. Returns the former status.
vec4 write_converged(ivec2 texel, Material own)
{
    vec4 status = texelFetch(u_status, texel, 0);
    o_status = vec4(status.xy, CONVERGED_AFTER, status.w);
    write_material(own);
    return status;
}
