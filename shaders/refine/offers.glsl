// What passes share that offer a texel other materials: reads u_status.

#include "refine/status.glsl"
#include "refine/votes.glsl"

// Whether an offer may replace a texel's own material, to be refined: its weights are another's, so that a fitness that
// is worse before it is refined decides nothing against many votes.
bool is_worth_refining(float fitness, float own_fitness, float votes, float own_votes)
{
    return fitness < CANDIDATE_RATIO * own_fitness || votes > CROWD * (1.0 + own_votes);
}

// Writes a texel's own material, of which nothing is left to do until an offer replaces it; returns its former status.
vec4 write_calm(ivec2 texel, Material own)
{
    vec4 status = texelFetch(u_status, texel, 0);
    o_status = vec4(status.xy, CALM, status.w);
    write_material(own);
    return status;
}
