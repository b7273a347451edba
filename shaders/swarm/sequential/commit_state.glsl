// Pass B, over the swarm atlas, in place: writes the candidate's position and velocity to the moved particle. Reads the
// candidate textures of pass A. A fragment cannot scatter, so every particle checks whether it is the moved one.

#include "swarm/atlas.glsl"

bool texel_kernel(ivec2 atlas_coord)
{
    ivec2 texel;
    int block;
    int particle;
    if (!atlas_owner(atlas_coord, texel, block, particle)) {
        return false;
    }
    if (int(texelFetch(u_verdict, texel, 0).w) != particle) {
        return false;
    }
    float x[MAX_DIMENSIONS];
    float v[MAX_DIMENSIONS];
    read_candidate_position(texel, x);
    read_candidate_velocity(texel, v);
    o_position = block_of(x, block);
    o_velocity = block_of(v, block);
    return true;
}
