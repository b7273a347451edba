// Pass B, over the swarm atlas, in place: takes the candidate's place and velocity where its own particle was moved.
// Reads the candidate textures of pass A. A fragment cannot scatter, so every particle looks whether it was chosen.

#include "swarm/atlas.glsl"

bool texel_kernel(ivec2 place)
{
    ivec2 texel;
    int block;
    int particle;
    if (!atlas_owner(place, texel, block, particle)) {
        return false;
    }
    if (int(texelFetch(u_verdict, texel, 0).w) != particle) {
        return false;
    }
    o_position = texelFetch(u_candidate_position_0, texel, 0);
    o_velocity = texelFetch(u_candidate_velocity_0, texel, 0);
#if BLOCKS > 1
    if (block == 1) {
        o_position = texelFetch(u_candidate_position_1, texel, 0);
        o_velocity = texelFetch(u_candidate_velocity_1, texel, 0);
    }
#endif
    return true;
}
