// Pass B, second part, over the swarm atlas, in place: a better candidate replaces the personal best of its particle.

#include "swarm/atlas.glsl"

bool texel_kernel(ivec2 atlas_coord)
{
    ivec2 texel;
    int block;
    int particle;
    if (!atlas_owner(atlas_coord, texel, block, particle)) {
        return false;
    }
    vec4 verdict = texelFetch(u_verdict, texel, 0);
    if (int(verdict.w) != particle || verdict.y == 0.0) {
        return false;
    }
    float x[MAX_DIMENSIONS];
    read_candidate_position(texel, x);
    o_best = block_of(x, block);
    o_fitness = verdict.x;
    return true;
}
