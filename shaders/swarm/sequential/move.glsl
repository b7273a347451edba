// Pass A, over W×H texels: moves one particle of every swarm and evaluates it where it has come to.
// Reads the swarm atlas (u_particle_*), the global bests, the estimates, the geometry and the sample stack.
// Writes the candidate: its place, its velocity, and in o_verdict (fitness, 1 if a personal best, 1 if a global best,
// which particle; −1 where nothing moved).
// With START it places particle u_particle instead of moving a random one.

#include "fitness/fitness.glsl"
#include "swarm/update.glsl"

bool texel_kernel(ivec2 texel)
{
    o_position_0 = vec4(0.0);
    o_velocity_0 = vec4(0.0);
#if BLOCKS > 1
    o_position_1 = vec4(0.0);
    o_velocity_1 = vec4(0.0);
#endif
    o_verdict = vec4(0.0, 0.0, 0.0, -1.0);
    float best = texelFetch(u_best_fitness, texel, 0).x;
    // A swarm that has reached the threshold h of the paper is done.
    if (state_at(texel) != TEXEL_SOLVED || best <= u_threshold) {
        return true;
    }

    float x[8];
    float v[8];
    Frame f = frame_at(texel);
#ifdef START
    int particle = u_particle;
    place_particle(texel, particle, x, v);
    float personal = UNFIT;
#else
    uvec4 choice = random_bits(u_seed, u_iteration, global_texel(texel), 0, RANDOM_CHOICE) >> 8u;
    int particle = int(choice.x % uint(PARTICLES));
    float mean[8];
    for (int i = 0; i < 8; i++) {
        mean[i] = 0.0;
    }
    if (u_c3 != 0.0) {
        neighbourhood_mean(texel, f, mean);
    }
    move_particle(texel, particle, mean, x, v);
#if NEIGHBOUR_EVERY > 0
    if ((u_iteration + 1) % NEIGHBOUR_EVERY == 0) {
        try_neighbour(texel, f, int(choice.y % 8u), x);
    }
#endif
    float personal = texelFetch(u_particle_fitness, atlas_texel(texel, 0, particle), 0).x;
#endif
    order_lobes(x, v);

    Material s = estimate_at(texel);
    decode(x, reach_of(scale_at(texel)), s);
    float weights;
    float fitness = fitness_of(texel, f, s, weights);
    fitness = fitness < UNFIT ? with_priors(fitness, weights, s) : UNFIT;

    o_position_0 = vec4(x[0], x[1], x[2], x[3]);
    o_velocity_0 = vec4(v[0], v[1], v[2], v[3]);
#if BLOCKS > 1
    o_position_1 = vec4(x[4], x[5], x[6], x[7]);
    o_velocity_1 = vec4(v[4], v[5], v[6], v[7]);
#endif
    // A first personal best is taken whatever it is worth: the particle must have been somewhere.
#ifdef START
    bool improved = true;
#else
    bool improved = fitness < personal;
#endif
    bool leads = fitness < best || (u_iteration < 0 && particle == 0);
    o_verdict = vec4(fitness, improved ? 1.0 : 0.0, leads ? 1.0 : 0.0, float(particle));
    return true;
}
