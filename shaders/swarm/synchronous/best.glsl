// Pass C of the synchronous swarm, over W×H texels: a better best of this generation replaces the global best.
// Reads the old global bests, and u_fitness and u_linear of this generation. Writes the new global bests.

#include "fitness/unfit.glsl"
#include "swarm/synchronous/moved.glsl"

bool texel_kernel(ivec2 texel)
{
    float x[MAX_DIMENSIONS];
    float w[MAX_WEIGHTS];
    read_best(texel, x);
    read_best_linear(texel, w);
    o_best_fitness = texelFetch(u_best_fitness, texel, 0).x;
    if (state_at(texel) == TEXEL_SOLVED && o_best_fitness > u_threshold) {
#ifdef START
        // Every texel needs a global best, even without observations.
        float best = 2.0 * UNFIT;
#else
        float best = o_best_fitness;
#endif
        int leader = -1;
        float fitness[MAX_PARTICLES];
        read_fitness(texel, fitness);
        for (int p = 0; p < PARTICLES; p++) {
            if (fitness[p] < best) {
                best = fitness[p];
                leader = p;
            }
        }
        if (leader >= 0) {
            float v[MAX_DIMENSIONS];
            moved_particle(texel, frame_at(texel), leader, x, v);
            read_linear(texel, w);
            o_best_fitness = best;
        }
    }
    write_best(x);
    write_best_linear(w);
    return true;
}
