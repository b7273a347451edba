// Shared by the passes that offer other materials to a texel. Reads u_status.

#include "refine/status.glsl"
#include "refine/votes.glsl"

// Whether an offer may replace a texel's material and be refined. Before that, its linear weights are another texel's, and
// its fitness says little: many votes suffice.
bool is_worth_refining(float fitness, float own_fitness, float votes, float own_votes)
{
    return fitness < CANDIDATE_RATIO * own_fitness || votes > CROWD * (1.0 + own_votes);
}

// Writes a texel's own material with the status calm; returns its former status.
vec4 write_calm(ivec2 texel, Material own)
{
    vec4 status = texelFetch(u_status, texel, 0);
    o_status = vec4(status.xy, CALM, status.w);
    write_material(own);
    return status;
}
