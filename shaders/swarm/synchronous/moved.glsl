// The new place of a particle in this iteration: a pure function, so that every pass computes the same.
// Reads u_mean: the neighbourhood means of Eq. 4.

#include "swarm/update.glsl"

void moved(ivec2 texel, Frame f, int particle, out float x[8], out float v[8])
{
#ifdef START
    place_particle(texel, particle, x, v);
#else
    float mean[8];
    read_mean(texel, mean);
    move_particle(texel, particle, mean, x, v);
#if NEIGHBOUR_EVERY > 0
    // The last four take the bests of the four texels beside this one: directions 1, 3, 4 and 6 of eight.
    int last = PARTICLES - 1 - particle;
    if ((u_iteration + 1) % NEIGHBOUR_EVERY == 0 && last < 4) {
        try_neighbour(texel, f, last < 2 ? 1 + 2 * last : 2 * last, x);
    }
#endif
#endif
    order_lobes(x, v);
}
