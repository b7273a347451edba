// Pass C of a swarm that moves all its particles at once, over W×H texels: takes the best of the generation as global
// best where it is better. Reads the old bests, writes the new ones.

#include "swarm/synchronous/moved.glsl"
#include "swarm/synchronous/fitnesses.glsl"

bool texel_kernel(ivec2 texel)
{
    o_best_0 = texelFetch(u_best_0, texel, 0);
#if BLOCKS > 1
    o_best_1 = texelFetch(u_best_1, texel, 0);
#endif
#if LINEAR_BLOCKS > 0
    o_best_linear_0 = texelFetch(u_best_linear_0, texel, 0);
#endif
#if LINEAR_BLOCKS > 1
    o_best_linear_1 = texelFetch(u_best_linear_1, texel, 0);
#endif
    float best = texelFetch(u_best_fitness, texel, 0).x;
    o_best_fitness = best;
    if (state_at(texel) != TEXEL_SOLVED || best <= u_threshold) {
        return true;
    }
    int leader = -1;
#ifdef START
    // Somebody must lead, even where no observation tells anything.
    best = 2.0 * UNFIT;
#endif
    for (int p = 0; p < PARTICLES; p++) {
        float fitness = fitness_at(texel, p);
        if (fitness < best) {
            best = fitness;
            leader = p;
        }
    }
    if (leader < 0) {
        return true;
    }
    float x[8];
    float v[8];
    moved(texel, frame_at(texel), leader, x, v);
    o_best_0 = vec4(x[0], x[1], x[2], x[3]);
#if BLOCKS > 1
    o_best_1 = vec4(x[4], x[5], x[6], x[7]);
#endif
#if LINEAR_BLOCKS > 0
    o_best_linear_0 = texelFetch(u_linear_0, texel, 0);
#endif
#if LINEAR_BLOCKS > 1
    o_best_linear_1 = texelFetch(u_linear_1, texel, 0);
#endif
    o_best_fitness = best;
    return true;
}
