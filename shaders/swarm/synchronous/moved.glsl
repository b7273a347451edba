// New position of a particle in this iteration. A pure function: every pass that calls it computes the same position.
// Reads u_mean, the neighbourhood means of Eq. 4.

#include "swarm/update.glsl"

void moved_particle(ivec2 texel, Frame f, int particle, out float x[MAX_DIMENSIONS], out float v[MAX_DIMENSIONS])
{
#ifdef START
    initialise_particle(texel, particle, x, v);
#else
    float mean[MAX_DIMENSIONS];
    read_mean(texel, mean);
    move_particle(texel, particle, mean, x, v);
#if NEIGHBOUR_INTERVAL > 0
    // The last four particles take the bests of the four texels that share an edge: directions 1, 3, 4 and 6 of eight.
    int from_end = PARTICLES - 1 - particle;
    if ((u_iteration + 1) % NEIGHBOUR_INTERVAL == 0 && from_end < 4) {
        try_neighbour(texel, f, from_end < 2 ? 1 + 2 * from_end : 2 * from_end, x);
    }
#endif
#endif
    order_lobes(x, v);
}
