// Pass B of the synchronous swarm, over the swarm atlas: writes the new position of every particle, which replaces the
// personal best if it is better. Reads the old atlas, writes the new one.

#include "swarm/synchronous/moved.glsl"

bool texel_kernel(ivec2 atlas_coord)
{
    ivec2 texel;
    int block;
    int particle;
    if (!atlas_owner(atlas_coord, texel, block, particle)) {
        return false;
    }
    o_position = texelFetch(u_particle_position, atlas_coord, 0);
    o_velocity = texelFetch(u_particle_velocity, atlas_coord, 0);
    o_best = texelFetch(u_particle_best, atlas_coord, 0);
    o_fitness = texelFetch(u_particle_fitness, atlas_coord, 0).x;
    // The same condition as in pass A: a particle that was not evaluated does not move.
    if (state_at(texel) != TEXEL_SOLVED || texelFetch(u_best_fitness, texel, 0).x <= u_threshold) {
        return true;
    }
    float x[MAX_DIMENSIONS];
    float v[MAX_DIMENSIONS];
    moved_particle(texel, frame_at(texel), particle, x, v);
    o_position = block_of(x, block);
    o_velocity = block_of(v, block);
    float fitness[MAX_PARTICLES];
    read_fitness(texel, fitness);
    // The initial position is always a personal best.
#ifdef START
    bool is_personal_best = true;
#else
    bool is_personal_best = fitness[particle] < o_fitness;
#endif
    if (is_personal_best) {
        o_best = o_position;
        o_fitness = fitness[particle];
    }
    return true;
}
