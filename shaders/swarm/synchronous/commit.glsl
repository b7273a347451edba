// Pass B of the synchronous swarm, over the swarm atlas: every particle takes its new place, and its personal best if that
// is better. Reads the old atlas, writes the new one.

#include "swarm/synchronous/moved.glsl"

bool texel_kernel(ivec2 place)
{
    ivec2 texel;
    int block;
    int particle;
    if (!atlas_owner(place, texel, block, particle)) {
        return false;
    }
    o_position = texelFetch(u_particle_position, place, 0);
    o_velocity = texelFetch(u_particle_velocity, place, 0);
    o_best = texelFetch(u_particle_best, place, 0);
    o_fitness = texelFetch(u_particle_fitness, place, 0).x;
    // The same condition as in pass A: a particle that was not evaluated has not moved.
    if (state_at(texel) != TEXEL_SOLVED || texelFetch(u_best_fitness, texel, 0).x <= u_threshold) {
        return true;
    }
    float x[8];
    float v[8];
    moved(texel, frame_at(texel), particle, x, v);
    o_position = block_of(x, block);
    o_velocity = block_of(v, block);
    float fitness[16];
    read_fitness(texel, fitness);
    // The first place is always a personal best.
#ifdef START
    bool improved = true;
#else
    bool improved = fitness[particle] < o_fitness;
#endif
    if (improved) {
        o_best = o_position;
        o_fitness = fitness[particle];
    }
    return true;
}
