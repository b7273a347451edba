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

// Writes the texel's own material, with the status of a converged texel. Returns this status.
Status write_converged(ivec2 texel, Material own)
{
    Status status = status_from(texelFetch(u_status, texel, 0));
    status.stalled = CONVERGED_AFTER;
    o_status = stored_status(status);
    write_material(own);
    return status;
}
