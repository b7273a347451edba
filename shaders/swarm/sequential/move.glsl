// Pass A, over W×H texels: moves one particle of every swarm and evaluates its fitness.
// Reads the swarm atlas (u_particle_*), the global bests, the estimates, the geometry and the sample stack.
// Writes the candidate (position, velocity) and o_verdict: fitness; 1 if it is a personal best; 1 if it is a global
// best; number of the particle, −1 if no particle moved.
// With START it initialises particle u_particle instead of moving a random one.

#include "fitness/fitness.glsl"
#include "swarm/update.glsl"

bool texel_kernel(ivec2 texel)
{
    float x[MAX_DIMENSIONS];
    float v[MAX_DIMENSIONS];
    for (int i = 0; i < MAX_DIMENSIONS; i++) {
        x[i] = 0.0;
        v[i] = 0.0;
    }
    write_position(x);
    write_velocity(v);
    o_verdict = vec4(0.0, 0.0, 0.0, -1.0);
    float best_fitness = texelFetch(u_best_fitness, texel, 0).x;
    // A swarm that has reached the paper's threshold h stops.
    if (state_at(texel) != TEXEL_SOLVED || best_fitness <= u_threshold) {
        return true;
    }

    Texel t = observed_texel(texel);
#ifdef START
    int particle = u_particle;
    initialise_particle(texel, particle, x, v);
    float personal_fitness = UNFIT;
#else
    uvec4 choice = random_bits(u_seed, u_iteration, global_texel(texel), 0, RANDOM_CHOICE) >> 8u;
    int particle = int(choice.x % uint(PARTICLES));
    float mean[MAX_DIMENSIONS];
    for (int i = 0; i < MAX_DIMENSIONS; i++) {
        mean[i] = 0.0;
    }
    if (u_c3 != 0.0) {
        neighbourhood_mean(texel, t.frame, mean);
    }
    move_particle(texel, particle, mean, x, v);
#if NEIGHBOUR_INTERVAL > 0
    if ((u_iteration + 1) % NEIGHBOUR_INTERVAL == 0) {
        try_neighbour(texel, t.frame, int(choice.y % 8u), x);
    }
#endif
    float personal_fitness = texelFetch(u_particle_fitness, atlas_texel(texel, 0, particle), 0).x;
#endif
    order_lobes(x, v);

    Material s = estimate_at(texel);
    decode(x, albedo_limit_of(t.radiance_scale), s);
    float weights;
    float fitness = fitness_of(t, s, weights);
    fitness = fitness < UNFIT ? with_priors(fitness, weights, s) : UNFIT;

    write_position(x);
    write_velocity(v);
    // The initial position is always a personal best.
#ifdef START
    bool is_personal_best = true;
#else
    bool is_personal_best = fitness < personal_fitness;
#endif
    bool is_global_best = fitness < best_fitness || (u_iteration < 0 && particle == 0);
    o_verdict = vec4(fitness, is_personal_best ? 1.0 : 0.0, is_global_best ? 1.0 : 0.0, float(particle));
    return true;
}
